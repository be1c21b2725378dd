# SPDX-License-Identifier: Apache-2.0
"""The results of a sweep, as an xarray.Dataset with a dimension for each axis."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import flock_sim
from flock_sim.analysis.metrics import STABLE_BELOW, Metrics, mean_over_birds, measure
from flock_sim.analysis.time_means import TimeMeans
from flock_sim.analysis.verdict import WORDS, Verdicts
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.physics.flock_state import FlockState
from flock_sim.recording.run import Run
from flock_tools.experiments.sweep.specification import Flight, Sweep

PACKAGES = ("numpy", "numba", "xarray", "scipy", "mcap")
"""Packages whose versions are attributes of the dataset."""

BIRD, GAP = "bird", "gap"

CRITERION = f"sigma_U < {STABLE_BELOW:g}"

ATTRIBUTES = {
    "mean_speed": ("mean speed of the birds at the end", "U_min"),
    "speed_std": ("spread of the birds' speeds at the end, sigma_U", "U_min"),
    "verdict": ("verdict on the flight", "1"),
    "stalled_at": ("first recorded time at which a bird has stalled; nan: none has", "b/U_min"),
    "stalled_bird": ("bird that has stalled; 0: none has", "1"),
    "holds": (f"whether the flock is stable by the paper's criterion, {CRITERION}", "1"),
    "diverged": ("whether positions or speeds are not finite at the end", "1"),
    "mean_drag_reduction": ("drag saved at the end, mean over the birds", "1"),
    "time_mean_speed": ("mean speed of the birds from averaged_from to the end", "U_min"),
    "time_mean_drag_reduction": (
        "drag saved, mean from averaged_from to the end and over the birds",
        "1",
    ),
    "averaged_from": ("time from which time means are computed", "b/U_min"),
    "mean_spacing": ("mean distance along the flight of neighbours at the end", "b"),
    "flight": ("number of the flight", "1"),
    "member": ("number of the member in its flight", "1"),
    "drag_reduction": ("drag saved at the end, over that of the standard bird at cruise", "1"),
    "position": ("streamwise position at the end", "b"),
    "speed": ("speed at the end", "U_min"),
    "spacing": ("streamwise position of bird i + 1 from bird i at the end", "b"),
    BIRD: ("bird, from the tail of the left wing", "1"),
    GAP: ("gap between bird i and bird i + 1", "1"),
}
"""Long name and unit of every variable, and of each coordinate that is not an axis."""


Values = dict[str, np.ndarray]
"""Results by name: arrays whose first dimension is the member."""

FLOWN = "flown"
"""Name of the array, beside the results of a sweep, that tells which members have been flown."""

KINDS: dict[str, type[np.generic]] = {
    **dict.fromkeys(("verdict", "holds", "diverged"), np.int8),
    **dict.fromkeys(("stalled_bird", "flight", "member"), np.int32),
}
"""Types of the results that are not float64."""


def dataset(sweep: Sweep, values: Values, command: str) -> xr.Dataset:
    """Return the results of all members, `values`, in the order of the sweep.

    The dimensions are the axes, plus `bird` or `gap` for variables with one value for each. The
    attributes are the sweep, the `command`, and versions.
    """
    found = labelled(values, sweep.flock.birds, coordinates(sweep))
    found.attrs = _attributes(sweep, command)
    found["verdict"].attrs |= {
        "flag_values": np.arange(len(WORDS), dtype=np.int8),
        "flag_meanings": " ".join(WORDS),
    }
    return found


def coordinates(sweep: Sweep) -> dict[str, xr.Variable]:
    """Return the coordinate of each axis, by dimension."""
    return {
        axis.dimension: xr.Variable(
            axis.dimension,
            list(axis.values),
            {"long_name": axis.long_name, "units": axis.units, "axis_name": axis.name},
        )
        for axis in sweep.axes
    }


def labelled(
    values: Mapping[str, np.ndarray],
    birds: int,
    axes: Mapping[str, xr.Variable],
    attributes: Mapping[str, tuple[str, str]] = ATTRIBUTES,
) -> xr.Dataset:
    """Return values of flocks as a dataset with `axes`, plus `bird` or `gap`, as dimensions.

    The first dimension of each array is the flock. The last axis varies fastest. `attributes` are
    the long name and the unit of each variable.
    """
    shape = [len(axis) for axis in axes.values()]
    found = xr.Dataset(
        {
            name: ([*axes, *_extra(array, birds)], array.reshape(*shape, *array.shape[1:]))
            for name, array in values.items()
        },
        axes,
    )
    for name in (BIRD, GAP):
        if name in found.sizes:
            found[name] = np.arange(1, found.sizes[name] + 1, dtype=np.int32)
    for name, (long_name, units) in attributes.items():
        if name in found.variables:
            found[name].attrs = {"long_name": long_name, "units": units}
    return found


def counted(found: xr.Dataset) -> dict[str, int]:
    """Return the number of members of a sweep with each of the verdicts."""
    return {word: int((found.verdict == k).sum()) for k, word in enumerate(WORDS)}


def netcdf(found: xr.Dataset) -> bytes:
    """Return a dataset as the bytes of a NetCDF 3 file with 64-bit offsets."""
    for variable in found.variables.values():
        variable.encoding["_FillValue"] = None  # nan means diverged or not stalled, not missing
    return bytes(found.to_netcdf(engine="scipy", format="NETCDF3_64BIT"))


def recorded(sweep: Sweep, flights: Sequence[Flight], bags: Sequence[Path]) -> Values:
    """Return the results of all members, read from the bags of all flights."""
    values: Values = {}
    for flight, bag in zip(flights, bags, strict=True):
        put(values, sweep.size, flight.members, _read(flight, bag))
    return values


def put(values: Values, size: int, members: Sequence[int], part: Values) -> None:
    """Put the results of some members, indices from 0, into `values`, those of `size` members."""
    for name, array in part.items():
        if name not in values:
            values[name] = np.zeros((size, *array.shape[1:]), array.dtype)
        values[name][list(members)] = array


def layout(size: int, birds: int) -> dict[str, tuple[type[np.generic], tuple[int, ...]]]:
    """Return the types and shapes of all results of `size` members, and of FLOWN."""
    lengths = {"drag_reduction": (birds,), "position": (birds,), "speed": (birds,)}
    lengths |= {"spacing": (birds - 1,)}
    single = ("mean_spacing", "spacing") if birds == 1 else ()
    names = [name for name in ATTRIBUTES if name not in (BIRD, GAP, *single)]
    found = {name: (KINDS.get(name, np.float64), (size, *lengths.get(name, ()))) for name in names}
    return {FLOWN: (np.bool_, (size,)), **found}


def measured(
    configuration: FlockConfiguration, end: FlockState, means: TimeMeans, verdicts: Verdicts
) -> Values:
    """Return the results of a flight that ended at `end`."""
    metrics = measure(configuration, end)
    return {
        **_told(metrics, end),
        "time_mean_speed": means.time_mean_speed,
        "time_mean_drag_reduction": means.time_mean_drag_reduction,
        "averaged_from": np.full(configuration.members, means.averaged_from),
        **_judged(verdicts),
    }


def places(flight: int, first: int, members: int) -> Values:
    """Return the places of members: the number of their flight, and those within it."""
    return {
        "flight": np.full(members, flight, dtype=np.int32),
        "member": np.arange(first, first + members, dtype=np.int32),
    }


def _read(flight: Flight, bag: Path) -> Values:
    """Return the results of a flight from its bag."""
    with Run(bag) as run:
        end, verdicts = run.at(), run.verdicts()
        means = run.time_means(end.time)
    configuration = flight.configuration
    if end.step != configuration.steps:
        raise FlockError(f"{bag}: ends at step {end.step} of {configuration.steps}; fly it again")
    found = measured(configuration, end, means, verdicts)
    return found | places(flight.number, 1, configuration.members)


def _told(metrics: Metrics, end: FlockState) -> Values:
    values: Values = {
        "mean_speed": metrics.mean_speed,
        "speed_std": metrics.speed_std,
        "holds": np.array(metrics.stable, dtype=np.int8),
        "diverged": np.array(~end.finite, dtype=np.int8),
        "mean_drag_reduction": metrics.mean_drag_reduction,
        "drag_reduction": metrics.drag_reduction,
        "position": end.position.T,
        "speed": end.speed.T,
    }
    if metrics.birds > 1:
        values["mean_spacing"] = mean_over_birds(np.abs(metrics.spacing.T))
        values["spacing"] = metrics.spacing
    return values


def _judged(verdicts: Verdicts) -> Values:
    return {
        "verdict": np.array([WORDS.index(word) for word in verdicts.verdict], dtype=np.int8),
        "stalled_at": np.array(verdicts.stalled_at, dtype=np.float64),
        "stalled_bird": np.array([bird or 0 for bird in verdicts.stalled_bird], dtype=np.int32),
    }


def _extra(array: np.ndarray, birds: int) -> list[str]:
    """Return the dimension of a variable besides the axes, if it has one."""
    return [] if array.ndim == 1 else [BIRD if array.shape[1] == birds else GAP]


def _attributes(sweep: Sweep, command: str) -> dict[str, Any]:
    versions = {"flock": flock_sim.__version__, "python": platform.python_version()}
    versions |= {package: version(package) for package in PACKAGES}
    return {
        "title": f"sweep of {sweep.size} flocks along "
        + ", ".join(axis.name for axis in sweep.axes),
        "configuration": sweep.text(),
        "command": command,
        "versions": ", ".join(f"{package} {number}" for package, number in versions.items()),
    }
