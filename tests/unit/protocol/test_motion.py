# SPDX-License-Identifier: Apache-2.0
"""Birds with laws of their own: single birds, and birds that know their neighbours by links."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import RunFailed
from flock_sim.messages.types import Checkpoint, Grant, State, Wing
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.physics.scaling import Scales
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.session import Channel, Outgoing
from flock_sim.reference.integrator import Reference
from support.own_laws import with_law

STEPS = 20
ALONE = {
    "birds": 1,
    "dt": 0.5,
    "t_max": 0.5 * STEPS,
    "record_every": 1,
    "span_ratios": ("1=0.9,1,1.1",),
}

WAVE = """
from math import cos


def wave(bird, time):
    return 0.3 * (1.5 - bird.speed) * cos(time)


def hold(bird, state, noise, speed=1.1, shake=1e-3):
    error = speed - bird.speed
    return 0.2 * error + 0.1 * state[0] + shake * noise[0], (error, 0.5 * state[0] - state[1])
"""


def fly(bird: BirdProtocol, checkpoint: Checkpoint, dt: float = 0.5) -> list[Outgoing]:
    """Fly a bird that is alone from `checkpoint` to the end; return what it sends."""
    epoch = checkpoint.epoch
    grants = [Grant(run_id=1, step=step, end=STEPS, dt=dt, epoch=epoch) for step in (0, STEPS)]
    return [
        *bird.receive_grant(grants[0]),
        *bird.receive_checkpoint(checkpoint),
        *bird.receive_grant(grants[1]),
    ]


def states(said: list[Outgoing]) -> list[State]:
    return [State.decode(data) for channel, data in said if channel is Channel.STATE]


def fly_alone(flock: FlockConfiguration) -> list[State]:
    bird = BirdProtocol(1, flock, run_id=1)
    return states(fly(bird, Checkpoint.of_start(run_id=1, epoch=1)))


def test_a_force_is_integrated_by_all_four_stages(tmp_path: Path) -> None:
    """A textbook RK4 of m dU/dt = T + F - lambda^2 k U^2 - lambda^4 k U^-2, written out."""
    flock = with_law(tmp_path, WAVE, "wave", **ALONE)
    scales, ratio, dt = Scales.of(flock), np.array([0.9, 1.0, 1.1]), flock.dt
    k, mass = scales.drag_coefficient_k, scales.mass_ratio * ratio**3

    def slope(time: float, u: FloatArray) -> FloatArray:
        force = 0.3 * (1.5 - u) * np.cos(time)
        drag = k * (ratio**2 * u**2 + ratio**4 / u**2)
        return np.asarray((ratio**4 * scales.cruise_drag + force - drag) / mass)

    u = np.full(3, scales.cruise_speed)
    flown = fly_alone(flock)
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


def test_no_force_changes_no_bit() -> None:
    plain = fly_alone(FlockConfiguration(**ALONE))
    for nothing in ("constant:force=0", "gust:std=0"):
        forced = fly_alone(FlockConfiguration(**ALONE, forcing=(nothing,)))
        assert [state.encode() for state in forced] == [state.encode() for state in plain]


@pytest.mark.parametrize("law", ["wave", "hold:seed=3"])
def test_a_flight_that_continues_from_a_checkpoint_is_the_same_flight(
    law: str, tmp_path: Path
) -> None:
    flock = with_law(tmp_path, WAVE, law, **ALONE)
    flown = fly_alone(flock)
    bird = BirdProtocol(1, flock, run_id=1)
    fly(bird, Checkpoint.of_start(run_id=1, epoch=1))
    at = flown[7]
    assert len(at.forcing_state) == 3 * flock.forcing_table.states
    checkpoint = Checkpoint(1, 7, 2, at.position, at.speed, forcing_state=at.forcing_state)
    again = states(fly(bird, checkpoint))
    assert [state.step for state in again] == list(range(8, STEPS + 1))
    for state in again:
        for name in ("speed", "position", "forcing_state"):
            expected = getattr(flown[state.step], name)
            assert getattr(state, name).tobytes() == expected.tobytes()


def test_a_checkpoint_without_the_state_of_the_laws_is_ignored(tmp_path: Path) -> None:
    flock = with_law(tmp_path, WAVE, "hold", **ALONE)
    bird = BirdProtocol(1, flock, run_id=1)
    at = fly_alone(flock)[7]
    bird.receive_grant(Grant(run_id=1, step=0, end=STEPS, dt=0.5, epoch=1))
    assert bird.receive_checkpoint(Checkpoint(1, 7, 1, at.position, at.speed)) == []
    assert bird.ignored == 1


LOOK = """
def look(neighbours, state):
    left, right = 0, len(neighbours.number) - 1
    return 0.0, (
        neighbours.position[left],
        neighbours.position[right],
        neighbours.speed[right],
        neighbours.circulation[right],
        neighbours.number[left] + 10.0 * neighbours.number[right],
    )
"""


@pytest.mark.parametrize(
    ("links", "heard_at"),
    [
        ((), (0, 1, 2, 3)),
        (("hold:interval=2",), (0, 0, 2, 2)),
        (("hold:interval=1,delay=1",), (None, 0, 1, 2)),
        (("hold:interval=2,delay=1",), (None, 0, 0, 2)),
        (("linear:interval=2",), (0, 0, 2, 2)),
    ],
    ids=str,
)
def test_a_law_is_given_what_the_bird_knows_by_its_links(
    links: tuple[str, ...], heard_at: tuple[int | None, ...], tmp_path: Path
) -> None:
    """The state of the law integrates what it is given: over a step it is the mean of it."""
    flock = with_law(
        tmp_path, LOOK, "look", 2, birds=3, dt=0.5, t_max=2.0, record_every=1, links=links
    )
    flown = fly_together(flock)
    plain = list(Reference(FlockConfiguration.given({**flock.parameters(), "forcing": []})).fly())
    integral = np.array([state.forcing_state for state in flown])
    means = np.diff(integral, axis=0) / flock.dt
    for step, heard in enumerate(heard_at):
        assert means[step, 4] == pytest.approx(31.0, rel=1e-14)
        if heard is None:  # nothing yet
            assert means[step, :4].tolist() == [0.0, 0.0, 0.0, 0.0]
            continue
        said = plain[heard]
        position, speed = said.position[[0, 2], 0], said.speed[[0, 2], 0]
        if links and links[0].startswith("linear"):
            position = position + speed * (step - heard + 0.5) * flock.dt
        # Without links: the mean of a step that is one of almost uniform motion.
        if not links:
            position = position + speed * 0.5 * flock.dt
        accuracy = 1e-13 if links else 1e-3
        assert means[step, :2] == pytest.approx(position, rel=accuracy)
        assert means[step, 2] == pytest.approx(speed[1], rel=accuracy)
        if links and links[0].startswith("linear"):
            accuracy = 1e-3  # this model continues the circulation, too
        assert means[step, 3] == pytest.approx(said.circulation[2, 0], rel=accuracy)


def fly_together(flock: FlockConfiguration) -> list[State]:
    """Fly birds that pass each other's messages on; return the states of bird 2."""
    birds = [BirdProtocol(number, flock, 1) for number in range(1, flock.birds + 1)]
    waiting: list[tuple[int, Outgoing]] = []

    def send(number: int, said: list[Outgoing]) -> None:
        waiting.extend((number, out) for out in said)

    end = flock.steps
    for bird in birds:
        bird.receive_grant(Grant(run_id=1, step=0, end=end, dt=flock.dt, epoch=1))
        for other in bird.neighbours:
            bird.receive_wing(Wing(1, other, flock.span_ratio[other - 1]))
        send(bird.bird, bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1)))
        grant = Grant(run_id=1, step=end, end=end, dt=flock.dt, epoch=1)
        send(bird.bird, bird.receive_grant(grant))
    flown = []
    while waiting:
        number, (channel, data) = waiting.pop(0)
        if channel is Channel.STATE and number == 2:
            flown.append(State.decode(data))
        elif channel is Channel.STAGE:
            for bird in birds:
                if number in bird.neighbours:
                    send(bird.bird, bird.receive_stage(data))
    return flown


def test_what_a_law_does_over_links_is_what_it_does_in_the_reference(tmp_path: Path) -> None:
    links = ("linear:interval=3,delay=2,noise=1e-3,seed=4",)
    flock = with_law(
        tmp_path, LOOK, "look", birds=4, dt=0.5, t_max=10.0, record_every=1, links=links
    )
    flown = fly_together(flock)
    for state, expected in zip(flown, Reference(flock).fly(), strict=True):
        assert state.forcing_state.tobytes() == expected.forcing_state[1].tobytes()


@pytest.mark.parametrize("dt", [0.5, 0.25])
def test_a_law_that_fails_ends_the_flight_of_its_bird_in_one_line(
    dt: float, tmp_path: Path
) -> None:
    source = "def law(bird, time): return 1.0 / (time < 2.1)\n"
    flock = with_law(tmp_path, source, "law", **{**ALONE, "dt": dt, "t_max": dt * STEPS})
    bird = BirdProtocol(1, flock, run_id=1)
    step = int(2.1 / dt)
    with pytest.raises(RunFailed, match=rf"^bird 1, step {step}: .*laws\.py:law' returns nan") as e:
        fly(bird, Checkpoint.of_start(1, 1), dt)
    assert "\n" not in str(e.value)
    assert bird.tick // STAGES == step


def test_a_bird_has_few_enough_attributes_to_be_read_fast(tmp_path: Path) -> None:
    assert len(vars(BirdProtocol(1, FlockConfiguration(**ALONE)))) <= 30
    assert len(vars(BirdProtocol(1, with_law(tmp_path, WAVE, "hold", **ALONE)))) <= 30
