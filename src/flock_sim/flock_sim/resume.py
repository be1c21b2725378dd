# SPDX-License-Identifier: Apache-2.0
"""What can be gone on with: a flight whose bag was cut short."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from flock_sim.command_line import FLOCK_OPTIONS
from flock_sim.core import topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.free_flight import GONE
from flock_sim.errors import FlockError
from flock_sim.run import Run

EXCLUDED = {
    "config": "--config",
    **FLOCK_OPTIONS,
    "output": "--output",
    "force": "--force",
    "no_record": "--no-record",
    "record_stages": "--record-stages",
}
"""Options of `fly` that a flight which is resumed has been given already."""


@dataclass(frozen=True)
class Resumable:
    """A flight that was cut short, or is complete already."""

    configuration: FlockConfiguration
    stages: bool
    """Whether Runge-Kutta stages are recorded too."""
    complete: bool


def resumable(run: Path, options: argparse.Namespace) -> Resumable:
    """Return what is in the bag `run`, for `fly` with `options` to go on with.

    Raises FlockError where it is no flight, or other options say what to fly.
    """
    for name, option in EXCLUDED.items():
        if getattr(options, name):
            raise FlockError(
                f"{option} and --resume exclude each other: what is flown, and where to, stands in "
                f"{run}"
            )
    try:
        with Run(run) as flown:
            if flown.real_time_factor:
                raise FlockError(GONE)
            if topics.GRANT_TOPIC not in flown.bag.topics:
                raise FlockError("it was not recorded by fly")
            return Resumable(
                flown.configuration, topics.stage_topic(1) in flown.bag.topics, not flown.missing
            )
    except FlockError as error:
        raise FlockError(
            f"--resume {run}: nothing to go on with ({error}); fly it anew with --output {run} "
            "--force"
        ) from error
