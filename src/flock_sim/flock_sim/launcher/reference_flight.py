# SPDX-License-Identifier: Apache-2.0
"""Flights in one loop, recorded as the nodes' recorder records them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.messages.types import Push, State, Time, Wing
from flock_sim.physics.flock_state import FlockState
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.row_assembler import Row
from flock_sim.reference.integrator import Reference


def record_reference(
    directory: Path,
    configuration: FlockConfiguration,
    live: Sequence[Perturbation] = (),
    *,
    replace: bool = False,
    on_step: Callable[[int], None] = lambda step: None,
) -> float:
    """Integrate a flock in one loop and record it; return the time of the loop alone, in s.

    `live` are pushes in flight. `replace` replaces an existing bag, and `on_step` is called with
    each recorded step.
    """
    seconds = 0.0
    with recording(directory, configuration, grants=False, live=bool(live), replace=replace) as run:
        for number, perturbation in enumerate(live, start=1):
            run.write_perturbation(Push.of(0, number, perturbation))
        flight = Reference(configuration, live=live).fly()
        while True:
            begun = time.perf_counter()
            recorded = next(flight, None)
            seconds += time.perf_counter() - begun
            if recorded is None:
                return seconds
            run.write_row(row(configuration, recorded))
            on_step(recorded.step)


def row(configuration: FlockConfiguration, recorded: FlockState) -> Row:
    """Return a recorded step as the messages that a flock of nodes would have sent."""
    birds = range(configuration.birds)
    ratio = configuration.span_ratio
    wings = [Wing(0, i + 1, ratio[i]).encode() for i in birds] if recorded.step == 0 else []
    time_message = Time.at(configuration.stamp(recorded.step)).encode()
    states = [state.encode() for state in State.of_flock(configuration, recorded)]
    return Row(recorded.step, wings, [], time_message, states)
