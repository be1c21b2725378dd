# SPDX-License-Identifier: Apache-2.0
"""The verdict on an observed flight is that on the whole flight, once enough was seen."""

from __future__ import annotations

from dataclasses import replace

import pytest

from flock_sim.analysis.flight_verdict import Flown
from flock_sim.analysis.metrics import speed_std
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock_state import FlockState
from flock_sim.reference.integrator import Reference
from flock_tools.live.flock_monitor import Sample
from flock_tools.live.running_verdict import MOST_ROWS, RunningVerdict


def sampled(state: FlockState) -> Sample:
    one = state.member(0)
    return Sample(
        birds=len(one.position),
        members=1,
        member=1,
        leader=1,
        step=state.step,
        time=state.time,
        end=None,
        coupling=None,
        real_time_factor=None,
        rate=None,
        position=one.from_leader.tolist(),
        speed=one.speed.tolist(),
        speed_std=float(speed_std(one.speed)),
        interaction_drag=one.interaction_drag.tolist(),
        drag_reduction=None,
        age=[],
        hears=None,
    )


@pytest.mark.parametrize("t_max", [200.0, 30000.0])
@pytest.mark.parametrize("ratio", ["1=1", "2=0.9"])
def test_it_is_the_verdict_on_the_flight(ratio: str, t_max: float) -> None:
    flock = FlockConfiguration(birds=3, t_max=t_max, span_ratios=(ratio,))
    states = list(Reference(flock).fly())
    verdict = RunningVerdict()
    assert verdict.told(flock) == ""
    for state in states:
        verdict.see(sampled(state))
    (word,) = Flown(flock, states).verdicts().verdict
    assert len(states) > MOST_ROWS or word == "settling"
    assert verdict.told(flock).startswith(f"{word} since t = 0: ")
    assert verdict.told(None) == ""


def test_memory_is_bounded_and_samples_stay_evenly_spaced() -> None:
    (start, *_) = Reference(FlockConfiguration(birds=2, t_max=1.0)).fly()
    verdict = RunningVerdict()
    for step in range(10 * MOST_ROWS):
        verdict.see(sampled(replace(start, step=step, time=float(step))))
    times = [row.time for row in verdict._rows]
    gaps = {later - earlier for earlier, later in zip(times, times[1:], strict=False)}
    assert MOST_ROWS / 2 - 1 <= len(times) <= MOST_ROWS
    assert max(gaps) <= 2 * min(gaps)


def test_a_flight_from_the_start_again_is_another_one_and_a_bird_can_stall() -> None:
    flock = FlockConfiguration(birds=2, t_max=1.0)
    (start, *_) = Reference(flock).fly()
    verdict = RunningVerdict()
    verdict.see(sampled(replace(start, step=5, time=5.0)))
    assert verdict.told(flock).startswith("settling since t = 5: ")
    verdict.see(sampled(replace(start, step=2, time=2.0)))
    assert verdict.told(flock).startswith("settling since t = 2: ")
    verdict.see(sampled(replace(start, step=3, time=3.0, speed=start.speed * [[1.0], [-1.0]])))
    assert verdict.told(flock) == "stalled: the speed of bird 2 is not above 0"
