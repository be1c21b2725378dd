# SPDX-License-Identifier: Apache-2.0
"""Flights: in one loop, or over ROS 2."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import xarray as xr

from flock_sim.analysis.verdict import WORDS
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, RunFailed
from flock_sim.launcher.reference_flight import record_reference
from flock_sim.recording.output_directory import own_output
from flock_tools.experiments.sweep.by_reference import fly_by_reference
from flock_tools.experiments.sweep.specification import Sweep
from flockflight.recorded import load, without_single_member

Output = str | Path | None
"""A directory for what is recorded; None: a temporary one."""


def run(configuration: FlockConfiguration, output: Output, force: bool) -> xr.Dataset:
    """Fly in one loop, with the bag in `output`."""
    with tempfile.TemporaryDirectory(prefix="flock-") as temporary, in_python():
        bag = Path(temporary) / "flight" if output is None else Path(output)
        with own_output(bag, force) as owned:
            record_reference(bag, configuration, replace=owned.replaces)
        return load(bag)


def fly(
    configuration: FlockConfiguration, output: Output, force: bool, timeout: float
) -> xr.Dataset:
    """Fly over ROS 2 in this process."""
    try:
        from flock_tools.testing import fly as fly_nodes
    except ImportError as error:
        raise FlockError(
            f"fly() needs ROS 2 ({error}): use ./flock python after `make setup`, or run(), which "
            "computes the same flight bit for bit"
        ) from None
    with in_python():
        found = fly_nodes(configuration, output=output, force=force, timeout=timeout)
    return without_single_member(found)


def run_all(plan: Sweep, output: Output, force: bool) -> xr.Dataset:
    """Fly all flocks of a sweep in one loop each, on all cores."""
    with in_python():
        found = fly_by_reference(plan, None if output is None else Path(output), force=force)
    words = np.array(WORDS)[found.verdict]
    return found.assign(verdict=(found.verdict.dims, words, _described(found.verdict)))


@contextmanager
def in_python() -> Iterator[None]:
    """Name the remedies of errors by the arguments of Python, not by the options of tools."""
    try:
        yield
    except RunFailed:
        raise
    except FlockError as error:
        told = str(error).replace("add --force", "pass force=True")
        raise FlockError(told.replace("another --output", "another output")) from None


def _described(verdict: xr.DataArray) -> dict[str, str]:
    return {name: verdict.attrs[name] for name in ("long_name", "units")}
