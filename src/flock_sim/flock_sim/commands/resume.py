# SPDX-License-Identifier: Apache-2.0
"""Resumable flights: flights whose bag was cut short."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from flock_sim.commands.law_option import load_recorded_laws
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.options import FLOCK_OPTIONS
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.protocol.free_flight import GONE
from flock_sim.recording.flight_bag import check_grants, has_stages, is_flight
from flock_sim.recording.output_directory import Output, own_bag
from flock_sim.recording.own_parts import BIRD, names
from flock_sim.recording.run import Run

EXCLUDED = {
    "config": "--config",
    **FLOCK_OPTIONS,
    "output": "--output",
    "force": "--force",
    "no_record": "--no-record",
    "record_stages": "--record-stages",
}
"""Options of `fly` that --resume excludes: the bag already determines them."""


@dataclass(frozen=True)
class Resumable:
    """A flight that was cut short, or that is already complete."""

    configuration: FlockConfiguration
    stages: bool
    """Whether Runge-Kutta stages are recorded too."""
    complete: bool
    output: Output


@contextmanager
def resumable(run: Path, options: argparse.Namespace) -> Iterator[Resumable]:
    """Own the bag `run` in the block, so that `fly` with `options` can continue its flight.

    Raises FlockError if it is no flight, if another process flies it, or if other options set the
    configuration or the output.
    """
    for name, option in EXCLUDED.items():
        if getattr(options, name):
            raise FlockError(
                f"{option} and --resume exclude each other: configuration and output are those of "
                f"{run}; leave one out"
            )
    if not run.exists():
        raise _refused(run, f"there is no bag {run}")
    with own_bag(run) as output:
        try:
            with Run(run) as flown:
                if flown.real_time_factor:
                    raise FlockError(GONE)
                _check_flight(flown)
                _check_birds(flown)
                own = flown.own_parts
                check_grants(flown.bag, flown.configuration)
                flown.perturbations()
                found = Resumable(
                    flown.configuration, has_stages(flown.bag), is_whole(flown), output
                )
        except FlockError as error:
            raise _refused(run, str(error)) from error
        load_recorded_laws(own, found.configuration, options.law, f"--resume {run}")
        yield found


def _check_flight(run: Run) -> None:
    """Raise FlockError unless the bag shows its topics, and that `fly` has recorded it."""
    announced = run.bag.topics
    last = topics.state_topic(run.configuration.birds)
    if not is_flight(run.bag) and last in announced:
        raise FlockError("it was not recorded by fly")
    # Types are written first: if a bag has topics, all types are known.
    if not is_flight(run.bag) or not announced:
        raise FlockError("it is cut off or damaged at its beginning, which describes its content")


def _check_birds(run: Run) -> None:
    """Raise FlockError if the run has birds that `fly` can't create."""
    if birds := names(run.own_parts, BIRD):
        raise FlockError(f"it was flown by birds of {birds}, which are not in Flock")


def is_whole(run: Run) -> bool:
    """Read a whole bag; return whether it has every due state and no damage."""
    if run.missing:
        return False
    flown = run.configuration
    broken: list[str] = []
    counts = Counter(topic for topic, _, _ in run.bag.salvage(broken))
    rows = flown.steps // flown.record_every + 1
    birds = range(1, flown.birds + 1)
    return not broken and all(counts[topics.state_topic(bird)] == rows for bird in birds)


def _refused(run: Path, why: str) -> FlockError:
    return FlockError(
        f"--resume {run}: nothing to continue ({why}); fly again with --output {run} --force"
    )
