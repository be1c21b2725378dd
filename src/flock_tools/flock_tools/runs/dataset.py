# SPDX-License-Identifier: Apache-2.0
"""A recorded run as an xarray.Dataset."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from flock_sim.configuration.flock_configuration import LISTS, FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages.state import ARRAYS
from flock_sim.messages.state_layout import forcing_states_of, members_of, steps_of, values_of
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.scaling import Scales, drag_reduction
from flock_sim.recording.run import Run

BLOCK = 4096
"""Number of states that are decoded at once."""

ATTRIBUTES = {
    "time": ("time", "t", "b/U_min"),
    "step": ("integration step", "", "1"),
    "bird": ("bird, from the tail of the left wing", "i", "1"),
    "member": ("member: one of the independent flocks flown at once", "", "1"),
    "position": ("streamwise position of the wing's centre", "x_i", "b"),
    "speed": ("speed", "U_i", "U_min"),
    "circulation": ("circulation of the bound vortex", "Gamma_i", "b U_min"),
    "interaction_drag": ("interaction drag; negative: drag saved", "sum_j D_ji", "rho b^2 U_min^2"),
    "mean_speed": ("mean speed over the steps since the last record", "<U_i>", "U_min"),
    "mean_interaction_drag": (
        "mean interaction drag over the steps since the last record",
        "<sum_j D_ji>",
        "rho b^2 U_min^2",
    ),
    "drag_reduction": ("drag saved, over that of the standard bird at cruise", "eta_i", "1"),
    "verdict": ("verdict on the flight up to the last time", "", "1"),
    "verdict_reason": ("reason of the verdict", "", "1"),
    "forcing_state": ("state of the laws that act on the bird", "", "1"),
    "state_number": ("number of a law's state", "", "1"),
    "span_ratio": ("wing span over that of the standard bird", "lambda_i", "1"),
    "lateral": ("lateral position of the wing's centre, from the leader", "y_i", "b"),
}
"""Long name, symbol in the paper and unit of every coordinate and variable."""

LATERAL_SIGN = (
    "The sign is that of the paper: negative on the left wing, where bird 1 flies. "
    "y of REP 103, to the left in m, is -lateral * b."
)
"""The attribute `comment` of `lateral`."""


def load(
    path: str | Path, start: float | None = None, end: float | None = None, stride: int = 1
) -> xr.Dataset:
    """Return a recorded run from time `start` to `end` in b / U_min, every `stride`-th record.

        run = load("runs/demo")
        run.speed.std("bird").plot(yscale="log")

    `position`, `speed`, `circulation`, `interaction_drag`, and the means `mean_speed` and
    `mean_interaction_drag` over all steps since the recorded state before (nan in bags of versions
    that did not record them) and `drag_reduction` have dims (time, bird, member), `verdict`, on the
    flight up to the last of these times, and `verdict_reason` (member),
    `span_ratio` and `lateral` (bird, member), `forcing_state`, if laws with a state act on birds,
    (time, bird, state_number, member), the coordinate `step` (time); all dimensionless, with
    `long_name`, `units` and the paper's `symbol` as attributes. `lateral` is negative on the left
    wing, where bird 1 flies, and says so in `comment`. The attributes of the dataset are the
    configuration, the leader and the unit of time in s. A truncated bag also has `missing`; its
    last time is the last one that all birds have.

    Raises FlockError if the bag does not exist, is not Flock's, or has nothing at these times.
    """
    with Run(path) as run:
        found = read(run, start, end, stride)
        verdicts = run.verdicts(float(found.time[-1]))
    found["verdict"] = "member", verdicts.verdict
    found["verdict_reason"] = "member", verdicts.verdict_reason
    return _described(found)


def read(
    run: Run, start: float | None = None, end: float | None = None, stride: int = 1
) -> xr.Dataset:
    """Return the dataset of an open run, as `load` does, without the verdict."""
    for name, time in (("start", start), ("end", end)):
        if time is not None and not math.isfinite(time):
            raise FlockError(f"{name} = {time}: must be finite, or None for no bound")
    if stride < 1:
        raise FlockError(f"stride = {stride}: must be 1 or more")
    configuration = run.configuration
    every = configuration.record_every
    interval = every * configuration.dt
    first, last = 0, run.at().step // every
    # The tolerance is for times such as 3 * 0.1, which rounding moves just beyond their row.
    if start is not None:
        first = max(first, math.ceil(start / interval - 1e-9))
    if end is not None:
        last = min(last, math.floor(end / interval + 1e-9))
    if first > last:
        raise FlockError(
            f"{run.path}: no time from {start} to {end} was recorded; "
            f"multiples of {interval:.12g} up to {run.at().time:.12g} are"
        )
    rows = range(first, last + 1, stride)
    times = [configuration.time(row * every) for row in rows]
    values, forcing_states = _values(run, rows)
    ratio = configuration.span_ratio
    dims = ("time", "bird", "member")
    dataset = xr.Dataset(
        {name: (dims, values[k]) for k, name in enumerate(ARRAYS)}
        | {
            "drag_reduction": (dims, _drag_reduction(values, configuration)),
            "span_ratio": (dims[1:], ratio),
            "lateral": (dims[1:], formation.lateral_positions(ratio)),
        },
        {
            "time": times,
            "step": ("time", np.array(rows) * every),
            "bird": np.arange(1, configuration.birds + 1),
            "member": np.arange(1, configuration.members + 1),
        },
        _attributes(run),
    )
    if numbers := forcing_states.shape[2]:
        dataset["forcing_state"] = ("time", "bird", "state_number", "member"), forcing_states
        dataset = dataset.assign_coords(state_number=np.arange(1, numbers + 1))
    return _described(dataset)


def _described(dataset: xr.Dataset) -> xr.Dataset:
    """Give all variables and coordinates their names, symbols and units."""
    for name, (long_name, symbol, units) in ATTRIBUTES.items():
        if name not in dataset.variables:
            continue  # of a flight without forcing
        dataset[name].attrs = {"long_name": long_name, "units": units}
        if symbol:
            dataset[name].attrs["symbol"] = symbol
    dataset.lateral.attrs["comment"] = LATERAL_SIGN
    return dataset


def _values(run: Run, rows: range) -> tuple[FloatArray, FloatArray]:
    """Return the values and the forcing states of `rows`; nan if not recorded.

    Their shapes are (6, rows, birds, members) and (rows, birds, numbers, members).
    """
    configuration = run.configuration
    birds = range(1, configuration.birds + 1)
    column = {topics.state_topic(bird): bird - 1 for bird in birds}
    values = np.full((len(ARRAYS), len(rows), len(birds), configuration.members), np.nan)
    numbers = run.at().forcing_state.shape[1]
    forcing = np.full((len(rows), len(birds), numbers, configuration.members), np.nan)
    states: list[bytes] = []
    birds_of_states: list[int] = []

    def place() -> None:
        row, rest = np.divmod(steps_of(states), configuration.record_every)
        row, off = np.divmod(row - rows.start, rows.step)
        due = (rest == 0) & (off == 0) & (row >= 0) & (row < len(rows))
        arrays = values_of(states, configuration.members)[due]
        bird = np.array(birds_of_states)[due]
        values[:, row[due], bird] = arrays.swapaxes(0, 1)
        if numbers:
            found = forcing_states_of(states, numbers, configuration.members)
            forcing[row[due], bird] = found[due]
        states.clear()
        birds_of_states.clear()

    start = configuration.stamp(rows[0] * configuration.record_every)
    end = configuration.stamp(rows[-1] * configuration.record_every) + 1
    for topic, _, data in run.bag.messages(list(column), start, end):
        if members_of(data) != configuration.members:
            raise FlockError(
                f"{run.path}: {topic}: a state is not as Flock writes it for "
                f"{configuration.members} members; take another copy of the bag"
            )
        states.append(data)
        birds_of_states.append(column[topic])
        if len(states) == BLOCK:
            place()
    if states:
        place()
    return values, forcing


def _drag_reduction(values: FloatArray, configuration: FlockConfiguration) -> FloatArray:
    """Return eta of all rows, birds and members from the values of all states."""
    drag = values[ARRAYS.index("interaction_drag")]
    return drag_reduction(drag, Scales.of(configuration).cruise_drag)


def attributes_of(configuration: FlockConfiguration) -> dict[str, Any]:
    """Return the keys of a configuration as attributes, in types that NetCDF supports."""
    found = configuration.parameters()
    return {**found, **{key: " ".join(found[key]) or "none" for key in LISTS}}


def _attributes(run: Run) -> dict[str, Any]:
    """Return the attributes of the whole run, in types that NetCDF supports."""
    configuration = run.configuration
    attributes = attributes_of(configuration)
    attributes["leader"] = formation.leader(configuration.birds)
    attributes["second"] = configuration.second
    if run.missing:
        attributes["missing"] = run.missing
    if run.own_parts:
        attributes["own_parts"] = ", ".join(map(str, run.own_parts))
    return attributes
