# SPDX-License-Identifier: Apache-2.0
"""Flights: in one loop, or over ROS 2."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import xarray as xr

from flock_sim.analysis.verdict import WORDS
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.launcher.reference_flight import record_reference
from flock_sim.recording.output_directory import own_output
from flock_tools.experiments.sweep.by_reference import fly_by_reference
from flock_tools.experiments.sweep.specification import Sweep
from flockflight.recorded import load, without_single_member


def run(configuration: FlockConfiguration, output: str | Path | None) -> xr.Dataset:
    """Fly in one loop, with the bag in `output`, or in a temporary directory if None."""
    with tempfile.TemporaryDirectory(prefix="flock-") as temporary:
        bag = Path(temporary) / "flight" if output is None else Path(output)
        with own_output(bag, force=False):
            record_reference(bag, configuration)
        return load(bag)


def fly(configuration: FlockConfiguration, output: str | Path | None, timeout: float) -> xr.Dataset:
    """Fly over ROS 2 in this process."""
    try:
        from flock_tools.testing import fly as fly_nodes
    except ImportError as error:
        raise FlockError(
            f"fly() needs ROS 2 ({error}): use ./flock python after `make setup`, or run(), which "
            "computes the same flight bit for bit"
        ) from None
    return without_single_member(fly_nodes(configuration, output=output, timeout=timeout))


def run_all(plan: Sweep, output: str | Path | None) -> xr.Dataset:
    """Fly all flocks of a sweep in one loop each, on all cores."""
    found = fly_by_reference(plan, None if output is None else Path(output))
    words = np.array(WORDS)[found.verdict]
    return found.assign(verdict=(found.verdict.dims, words, _described(found.verdict)))


def _described(verdict: xr.DataArray) -> dict[str, str]:
    return {name: verdict.attrs[name] for name in ("long_name", "units")}
