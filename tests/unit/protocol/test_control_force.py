# SPDX-License-Identifier: Apache-2.0
"""Birds with a control: single birds and birds in a flock."""

from __future__ import annotations

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.types import Checkpoint, Grant, State, Wing
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.physics.scaling import Scales
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.control_force import Control, Perception
from flock_sim.protocol.session import Channel, Outgoing
from flock_sim.reference.integrator import Reference

STEPS = 20
ALONE = FlockConfiguration(
    birds=1, dt=0.5, t_max=0.5 * STEPS, record_every=1, span_ratios=("1=0.9,1,1.1",)
)


def fly(bird: BirdProtocol, checkpoint: Checkpoint) -> list[Outgoing]:
    """Fly a bird that is alone from `checkpoint` to the end; return what it says."""
    epoch = checkpoint.epoch
    grants = [
        Grant(run_id=1, step=step, end=STEPS, dt=ALONE.dt, epoch=epoch) for step in (0, STEPS)
    ]
    return [
        *bird.receive_grant(grants[0]),
        *bird.receive_checkpoint(checkpoint),
        *bird.receive_grant(grants[1]),
    ]


def states(said: list[Outgoing]) -> list[State]:
    return [State.decode(data) for channel, data in said if channel is Channel.STATE]


def fly_alone(control: Control | None) -> list[State]:
    bird = BirdProtocol(1, ALONE, run_id=1, control=control)
    return states(fly(bird, Checkpoint.of_start(run_id=1, epoch=1)))


def force(time: float, speed: np.ndarray) -> np.ndarray:
    return 0.3 * (1.5 - speed) * np.cos(time)


def test_a_force_is_integrated_by_all_four_stages():
    """A textbook RK4 of m dU/dt = T + F - lambda^2 k U^2 - lambda^4 k U^-2, written out."""
    scales, ratio, dt = Scales.of(ALONE), np.array([0.9, 1.0, 1.1]), ALONE.dt
    k, mass = scales.drag_coefficient_k, scales.mass_ratio * ratio**3

    def slope(time: float, u: np.ndarray) -> np.ndarray:
        drag = k * (ratio**2 * u**2 + ratio**4 / u**2)
        return (ratio**4 * scales.cruise_drag + force(time, u) - drag) / mass

    u = np.full(3, scales.cruise_speed)
    flown = fly_alone(lambda view: force(view.time, view.speed))
    assert len(flown) == STEPS + 1
    for step, state in enumerate(flown):
        # Rounding of some ten operations a step.
        np.testing.assert_allclose(state.speed, u, rtol=STEPS * 10 * 2.0**-53, atol=0)
        t = step * dt
        first = slope(t, u)
        second = slope(t + dt / 2, u + dt / 2 * first)
        third = slope(t + dt / 2, u + dt / 2 * second)
        fourth = slope(t + dt, u + dt * third)
        u = u + dt / 6 * (first + 2 * second + 2 * third + fourth)
    assert abs(flown[-1].speed - scales.cruise_speed).min() > 1e-3


def test_no_force_changes_no_bit():
    without = fly_alone(None)
    for nothing in (0.0, np.zeros(3)):
        for state, other in zip(fly_alone(lambda view, nothing=nothing: nothing), without):
            assert state.encode() == other.encode()


def test_gone_on_with_from_a_checkpoint_it_is_the_same_flight():
    def control(view: Perception) -> np.ndarray:
        return force(view.time, view.speed)

    flown = fly_alone(control)
    bird = BirdProtocol(1, ALONE, run_id=1, control=control)
    fly(bird, Checkpoint.of_start(run_id=1, epoch=1))
    at = flown[7]
    again = states(fly(bird, Checkpoint(1, 7, 2, at.position, at.speed)))
    assert [state.step for state in again] == list(range(8, STEPS + 1))
    for state in again:
        assert state.speed.tobytes() == flown[state.step].speed.tobytes()
        assert state.position.tobytes() == flown[state.step].position.tobytes()


@pytest.mark.parametrize(
    ("links", "heard_at"), [((), (0, 1, 2)), (("hold:interval=2",), (0, 0, 2))], ids=str
)
def test_a_control_is_given_what_the_bird_knows_stage_by_stage(links, heard_at):
    flock = FlockConfiguration(birds=3, dt=0.5, t_max=1.0, record_every=1, links=links)
    seen: list[Perception] = []

    def look(view: Perception) -> float:
        seen.append(view)
        return 0.0

    birds = [BirdProtocol(n, flock, 1, control=look if n == 2 else None) for n in (1, 2, 3)]
    waiting: list[Outgoing] = []
    for bird in birds:
        bird.receive_grant(Grant(run_id=1, step=0, end=2, dt=0.5, epoch=1))
        for other in bird.neighbours:
            bird.receive_wing(Wing(1, other, flock.span_ratio[other - 1]))
        waiting += bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1))
        waiting += bird.receive_grant(Grant(run_id=1, step=2, end=2, dt=0.5, epoch=1))
    while waiting:
        channel, data = waiting.pop(0)
        if channel is Channel.STAGE:
            waiting += [out for bird in birds for out in bird.receive_stage(data)]

    assert [view.time for view in seen] == [0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1.0, 1.0]
    reference = [state.position for state in Reference(flock).fly()]
    for step, heard in enumerate(heard_at):
        view = seen[STAGES * step]
        assert (view.bird, view.neighbours) == (2, (1, 3))
        np.testing.assert_array_equal(view.position, reference[step][1])
        np.testing.assert_array_equal(view.positions, reference[heard][[0, 2]])


def test_of_whom_nothing_is_known_the_position_is_nan():
    flock = FlockConfiguration(birds=2, t_max=2.0, links=("hold:delay=1",))
    seen: list[Perception] = []

    def look(view: Perception) -> float:
        seen.append(view)
        return 0.0

    bird = BirdProtocol(1, flock, 1, control=look)
    other = BirdProtocol(2, flock, 1)
    for flies, neighbour in ((bird, 2), (other, 1)):
        flies.receive_grant(Grant(1, 0, 2, 1.0, 1))
        flies.receive_wing(Wing(1, neighbour, flock.span_ratio[neighbour - 1]))
    bird.receive_checkpoint(Checkpoint.of_start(1, 1))
    for channel, data in other.receive_checkpoint(Checkpoint.of_start(1, 1)):
        if channel is Channel.STAGE:
            bird.receive_stage(data)
    assert np.isnan(seen[0].positions).all()


def test_what_is_no_force_is_refused():
    with pytest.raises(
        FlockError, match=r"the control of bird 1 returns .*: must be .* 3, one for each"
    ):
        fly_alone(lambda view: np.zeros(2))


def test_a_bird_has_few_enough_attributes_to_be_read_fast():
    assert len(vars(BirdProtocol(1, ALONE))) <= 30
    assert len(vars(BirdProtocol(1, ALONE, control=lambda view: 0.0))) <= 30
