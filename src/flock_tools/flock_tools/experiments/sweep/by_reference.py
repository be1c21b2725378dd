# SPDX-License-Identifier: Apache-2.0
"""Flies a sweep by the reference: without ROS, on all cores or a Dask cluster.

The results are those of the flights over ROS, to the bit. Instead of bags, the results of the
members that have been flown are kept in one file.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from threading import Event, Lock
from typing import Any

import numpy as np
import xarray as xr

from flock_sim.analysis.flight_verdict import Flown
from flock_sim.analysis.time_means import Averaging
from flock_sim.analysis.verdict import WORDS
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.progress import counter
from flock_sim.errors import FlockError
from flock_sim.launcher.precompile import warm_reference
from flock_sim.outside.array_file import read_arrays
from flock_sim.physics.flock_state import FlockState
from flock_sim.recording.own_parts import own_laws, own_link_models
from flock_sim.reference.integrator import Reference
from flock_tools.experiments.sweep.dataset import (
    FLOWN,
    Values,
    dataset,
    layout,
    measured,
    netcdf,
    places,
    put,
)
from flock_tools.experiments.sweep.directory import SweepDirectory
from flock_tools.experiments.sweep.size import AT_ONCE
from flock_tools.experiments.sweep.specification import Part, Sweep
from flock_tools.experiments.workers import Workers, workers

AHEAD = 4
"""Parts submitted ahead per worker."""

SAVE_EVERY = 5.0
"""Time between two writes of the results so far, in s: a kill loses this time, and the parts that
are being flown."""

PAIR_STEPS = 1_000_000
"""Pair-steps between two checks of `halt`: some tenths of a second."""

OnProgress = Callable[[int], None]


def fly_by_reference(
    sweep: Sweep,
    output: Path | None = None,
    *,
    at_once: int = AT_ONCE,
    scheduler: str | None = None,
    force: bool = False,
    command: str = "",
) -> xr.Dataset:
    """Fly all members of a sweep without ROS, and return their results.

    `output` is the directory of the sweep: sweep.nc is written to it, and an interrupted sweep goes
    on from there; None: nothing is written. `at_once` is the number of members of a flight, which
    the variables `flight` and `member` count by. `scheduler` is the address of a Dask scheduler;
    None: the cores of this machine. `force` replaces another sweep in `output`. `command` becomes
    an attribute of the dataset.

    Raises FlockError if a member can't be flown, if the output is refused, or as `workers`.
    """
    parts = sweep.parts(at_once)
    if output is None:
        return dataset(sweep, fly_parts(sweep, parts, None, scheduler)[0], command)
    directory = SweepDirectory(output)
    with directory.held(sweep.plan(at_once, reference=True), force):
        found = dataset(sweep, fly_parts(sweep, parts, directory, scheduler)[0], command)
        directory.write(directory.data, netcdf(found))
        return found


def fly_parts(
    sweep: Sweep, parts: Sequence[Part], directory: SweepDirectory | None, scheduler: str | None
) -> tuple[Values, list[Part]]:
    """Fly the `parts` that `directory` has no results of; return all results, and these parts.

    Results are saved in `directory`, however the flights end.
    """
    results = _Results(sweep.size, sweep.flock.birds, directory)
    rest = [part for part in parts if not results.have(part)]
    if rest:
        links = any(not part.configuration.link_table.plain for part in rest)
        warm_reference(("hold",) if links else ())
        total = sum(part.member_steps for part in rest)
        with workers(scheduler) as pool, counter("flying", "member-steps", total) as show:
            try:
                _fly(rest, pool, results, show)
            finally:
                results.save()
    return results.values, rest


def _fly(
    parts: Sequence[Part], pool: Workers, results: _Results, on_progress: Callable[[float], None]
) -> None:
    """Fly `parts` on all workers, and add their results."""
    halt, lock = Event(), Lock()

    def count_up(member_steps: int) -> None:
        with lock:
            on_progress(member_steps)

    def submit(part: Part) -> Future[Values]:
        if pool.local:
            return pool.executor.submit(fly_members, part.configuration, halt, count_up)
        parameters = part.configuration.parameters()
        return pool.executor.submit(_fly_there, parameters, _own(part.configuration))

    remaining = iter(parts)
    flying = {submit(part): part for part in itertools.islice(remaining, AHEAD * pool.count)}
    try:
        while flying:
            done, _ = wait(flying, return_when=FIRST_COMPLETED)
            for future in done:
                part = flying.pop(future)
                results.add(part, future.result())
                if not pool.local:
                    count_up(part.member_steps)
                flying |= {submit(part): part for part in itertools.islice(remaining, 1)}
    except BaseException:
        halt.set()
        for future in flying:
            future.cancel()
        raise


def fly_members(
    configuration: FlockConfiguration,
    halt: Event | None = None,
    on_progress: OnProgress = lambda member_steps: None,
) -> Values:
    """Fly all members of `configuration` to the end, and return their results.

    `on_progress` is called with the number of member-steps just taken. Once `halt` is set, the
    flight ends, and nothing is returned.
    """
    states = list(_states(configuration, halt or Event(), on_progress))
    end = states[-1]
    if end.step < configuration.steps:
        return {}
    averaging, birds = Averaging(configuration, end.time, None), np.arange(configuration.birds)
    for state in states:
        means = np.stack([state.mean_speed, state.mean_interaction_drag], axis=1)
        averaging.add(birds, np.full(len(birds), state.step), means)
    verdicts = Flown(configuration, states).verdicts()
    return measured(configuration, end, averaging.result(), verdicts)


def _states(
    configuration: FlockConfiguration, halt: Event, on_progress: OnProgress
) -> Iterator[FlockState]:
    """Yield all recorded states, the one at the end among them."""
    flight = Reference(configuration)
    steps, every, members = configuration.steps, configuration.record_every, configuration.members
    most = max(1, PAIR_STEPS // (max(1, len(flight.flock.pairs)) * members))
    while flight.step < steps and not halt.is_set():
        count = min(most, steps - flight.step)
        first = -(-flight.step // every)
        for row, arrays in enumerate(flight.advance(count), first):
            yield FlockState(row * every, configuration.time(row * every), *arrays)
        on_progress(count * members)
    yield FlockState(flight.step, configuration.time(flight.step), *flight.observe())


def _fly_there(parameters: dict[str, Any], own: Sequence[tuple[str, str]]) -> Values:
    """Do as `fly_members` in another process, which loads the own parts of the flight itself."""
    configuration = FlockConfiguration.given(parameters)
    for (part, digest), (_, here) in zip(own, _own(configuration), strict=True):
        if digest != here:
            raise FlockError(
                f"{part}: its file on a worker of the cluster is not the same as here; copy it to "
                "the directory of every worker"
            )
    return fly_members(configuration)


def _own(configuration: FlockConfiguration) -> list[tuple[str, str]]:
    """Return name and digest of the laws and link models that are not in Flock."""
    parts = [*own_laws(configuration), *own_link_models(configuration)]
    return [(str(part), part.digest) for part in parts]


@dataclass
class _Results:
    """The results so far of `size` members, flocks of `birds`, and the file with them.

    Raises FlockError if the file is damaged: all members that it has are then in doubt.
    """

    size: int
    birds: int
    directory: SweepDirectory | None
    values: Values = field(init=False, default_factory=dict)
    _saved: float = field(init=False, default=-np.inf)
    """When they were saved, by the monotonic clock."""

    def __post_init__(self) -> None:
        self.flown = np.zeros(self.size, dtype=bool)
        if self.directory is None or not self.directory.results.exists():
            return
        try:
            self.values = read_arrays(self.directory.results, layout(self.size, self.birds))
            self.flown = self.values.pop(FLOWN)
            if not set(np.unique(self.values["verdict"])) <= set(range(len(WORDS))):
                raise ValueError("a verdict in it is none")
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise FlockError(
                f"{self.directory.results} can't be read ({reason}): replace the sweep with --force"
            ) from error

    def have(self, part: Part) -> bool:
        """Return whether all members of `part` have been flown."""
        return bool(self.flown[list(part.members)].all())

    def add(self, part: Part, found: Values) -> None:
        """Add the results of `part`, and save all from time to time."""
        found = found | places(part.flight, part.first, len(part.members))
        put(self.values, self.size, part.members, found)
        self.flown[list(part.members)] = True
        if time.monotonic() - self._saved > SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Write the results to the directory, if there is one and anything was flown."""
        if self.directory is None or not self.flown.any():
            return
        content = BytesIO()
        np.savez(content, **{FLOWN: self.flown}, **self.values)  # type: ignore[arg-type]
        self.directory.write(self.directory.results, content.getvalue())
        self._saved = time.monotonic()
