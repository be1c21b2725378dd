# SPDX-License-Identifier: Apache-2.0
"""A free-flying bird: exact with current states, on time, and with correct ages of states."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, RunFailed
from flock_sim.links.models import LinkModel
from flock_sim.links.registry import MODELS, register
from flock_sim.messages.epochs import REACH
from flock_sim.messages.handshake import handshake
from flock_sim.messages.rejection import AGAIN, FOREIGN, IMPOSSIBLE, MISSHAPEN, REPEATED, STALE
from flock_sim.messages.state import ARRAYS
from flock_sim.messages.types import Ages, Checkpoint, Grant, Progress, Stage, State, Wing
from flock_sim.physics import formation
from flock_sim.physics.dynamics import acceleration, drag_of_pair
from flock_sim.physics.flock import Flock
from flock_sim.protocol.bird_kernel import constants
from flock_sim.protocol.clock import Timekeeper
from flock_sim.protocol.free_bird import FreeBird
from flock_sim.protocol.free_flight import check_free
from flock_sim.protocol.session import Channel, Outgoing
from flock_sim.reference.integrator import Reference

RUN, EPOCH, FACTOR = 7, 3, 2.0
BEGIN = 1000.0
"""When step 0 is taken, in s."""


def grant(flown: FlockConfiguration, step: int, epoch: int = EPOCH, run_id: int = RUN) -> Grant:
    return Grant(run_id, step, flown.steps, flown.dt, epoch, handshake(flown, FACTOR))


def said(bird: int, step: int, values: tuple[object, ...], epoch: int = EPOCH) -> bytes:
    arrays = (np.atleast_1d(np.asarray(value, dtype=float)) for value in values)
    return Stage(RUN, step, epoch, bird, 0, *arrays).encode()


def ready(number: int, flown: FlockConfiguration) -> FreeBird:
    """A bird that knows its neighbours, who are all at their start."""
    bird = FreeBird(number, flown, FACTOR, incarnation=1)
    bird.receive_grant(grant(flown, 0))
    for other in bird.neighbours:
        bird.receive_wing(Wing(RUN, other, flown.span_ratio[other - 1]))
        bird.receive_stage(start_of(other, flown), BEGIN - 5.0)
    return bird


def start_of(bird: int, flown: FlockConfiguration) -> bytes:
    flock = Reference(flown).observe()[:3, bird - 1]
    return said(bird, 0, tuple(flock))


def of(channel: Channel, out: list[Outgoing]) -> list[bytes]:
    return [data for name, data in out if name is channel]


@pytest.fixture
def own_model() -> Iterator[None]:
    """Register a link model in whose flights each bird feels half of the wakes."""

    def halved(
        age: float, position: float, speed: float, circulation: float, rate: float
    ) -> tuple[float, float]:
        return position, 0.5 * circulation

    register(LinkModel("halved", halved))
    yield
    MODELS.pop()


@pytest.mark.usefixtures("own_model")
@pytest.mark.parametrize("link", ["hold", "linear", "halved"])
@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_on_fresh_news_it_flies_as_the_reference_does_to_the_bit(link: str, coupling: str) -> None:
    flown = FlockConfiguration(
        birds=4,
        coupling=coupling,
        t_max=60.0,
        record_every=1,
        span_ratios=("2=0.97,1.0,1.04",),
        perturbations=("3@20=0.2,-0.01",),
        links=(link,),
    )
    rows = list(Reference(flown).fly())
    for number in range(1, 5):
        bird = ready(number, flown)
        bird.receive_grant(grant(flown, flown.steps))
        for row in rows:
            for other in bird.neighbours:
                news = row.position, row.speed, row.circulation
                bird.receive_stage(said(other, row.step, tuple(n[other - 1] for n in news)), BEGIN)
            out = bird.tick(BEGIN + 10.0 * row.step)
            (data,) = of(Channel.STATE, out)
            values = tuple(getattr(row, name)[number - 1] for name in ARRAYS)
            assert data == State.at(flown, row.step, *values, run_id=RUN, epoch=EPOCH).encode()
            # Neighbours hear of every step; of the first, they have heard before the flight.
            heard = [said(number, row.step, values[:3])] if row.step else []
            assert of(Channel.STAGE, out) == heard
        assert bird.finished
        assert bird.due == math.inf


def test_a_link_that_is_exact_in_lockstep_is_flown_as_linear() -> None:
    ends = []
    for links in ((), ("linear",)):
        flown = FlockConfiguration(birds=3, t_max=30.0, record_every=30, links=links)
        bird = ready(2, flown)
        bird.receive_grant(grant(flown, 30))
        out = [o for k in range(31) for o in bird.tick(BEGIN + 10.0 * k)]
        ends.append(of(Channel.STATE, out)[-1])
    assert ends[0] == ends[1]


def test_without_news_it_flies_by_what_it_knew_moved_on() -> None:
    """As scipy has it, to within what halving the step changes, 15 times the error left by it."""
    speed, circulation = 1.05, 1.3

    def flown_to(dt: float) -> tuple[float, float]:
        flown = FlockConfiguration(birds=2, dt=dt, t_max=20.0, record_every=round(20.0 / dt))
        bird = FreeBird(1, flown, FACTOR)
        bird.receive_grant(grant(flown, 0))
        bird.receive_wing(Wing(RUN, 2, flown.span_ratio[1]))
        bird.receive_stage(said(2, 0, (1.5, speed, circulation)), BEGIN)
        bird.receive_grant(grant(flown, flown.steps))
        out = [o for k in range(flown.steps + 1) for o in bird.tick(BEGIN + 10.0 * k)]
        last = State.decode(of(Channel.STATE, out)[-1])
        return float(last.position[0]), float(last.speed[0])

    flown = FlockConfiguration(birds=2)
    flock, own = Flock.of(flown), constants(1, flown)[:, 0]

    def slopes(t: float, y: np.ndarray) -> list[float]:
        x = 1.5 + speed * t - y[0]
        geometry = (
            flock.lateral[0, 0],
            flock.half_span[0, 0],
            flock.half_span[1, 0],
            flock.even[0, 0],
        )
        drag, _ = drag_of_pair(x, *geometry, own[4] / y[1], circulation)
        return [y[1], acceleration(y[1], drag, *own[:4])]

    start = [formation.start_position(1, 2), flock.scales.cruise_speed]
    exact = solve_ivp(slopes, (0.0, 20.0), start, rtol=1e-13, atol=1e-13, method="DOP853").y[:, -1]
    coarse, fine = np.array(flown_to(1.0)), np.array(flown_to(0.5))
    assert np.all(np.abs(fine - exact) <= np.abs(coarse - fine))
    assert np.all(np.abs(coarse - exact) < 1e-4)


def test_ages_are_the_times_from_sending_to_use() -> None:
    flown = FlockConfiguration(birds=3, t_max=20.0, record_every=2)
    period = flown.second / FACTOR
    bird = ready(2, flown)
    bird.receive_grant(grant(flown, 20))
    told = []
    for step in range(7):
        now = BEGIN + step * period
        if step in (1, 4):
            bird.receive_stage(said(1, step, (0.0, 1.0, 1.0)), now - 0.001)
        if step == 3:  # what was sent at step 1 has come late
            bird.receive_stage(said(3, 1, (0.0, 1.0, 1.0)), BEGIN + period)
        told += [Ages.decode(data) for data in of(Channel.AGES, bird.tick(now))]
    assert [ages.step for ages in told] == [0, 2, 4, 6]
    # The first states were said before the flight began: they are of its beginning.
    expected = {
        "age": [[0, 0], [period + 0.001, 2 * period], [0.001, 3 * period],
                [2 * period + 0.001, 5 * period]],
        "age_max": [[0, 0], [period + 0.001, 2 * period], [2 * period + 0.001, 3 * period],
                    [2 * period + 0.001, 5 * period]],
        "behind": [[0, 0], [1, 2], [0, 3], [2, 5]],
    }  # fmt: skip
    for name, values in expected.items():
        # A double holds times around 1000 s to 1.1e-13 s; a few are added.
        np.testing.assert_allclose([getattr(a, name) for a in told], values, rtol=0, atol=1e-12)


def test_who_is_late_catches_up_and_counts_it() -> None:
    flown = FlockConfiguration(birds=1, t_max=20.0, record_every=1)
    period = flown.second / FACTOR
    bird = ready(1, flown)
    assert bird.due == math.inf  # no leave yet
    bird.receive_grant(grant(flown, 20))
    for step in range(3):
        bird.tick(BEGIN + step * period)
    assert bird.step == 3
    assert bird.tick(bird.due - 1e-6) == []
    late = BEGIN + 6.5 * period  # steps 3 to 6 are due; all but the last by a period or more
    while bird.due <= late:
        bird.tick(late)
    assert (bird.step, bird.late) == (7, 3)
    assert bird.lateness == pytest.approx(3.5 * period, abs=1e-12)


def test_it_begins_when_all_are_there_and_goes_no_further_than_its_leave() -> None:
    flown = FlockConfiguration(birds=2, t_max=20.0, record_every=5)
    bird = FreeBird(1, flown, FACTOR)
    assert bird.receive_stage(start_of(2, flown)) == []
    assert bird.ignored_for == {FOREIGN: 1}  # nothing is of a run that is not known
    out = bird.receive_grant(grant(flown, 0))
    assert [channel.value for channel, _ in out] == ["wing", "progress", "stage"]
    assert "wing of bird_02" in bird.waiting_for
    assert bird.receive_wing(Wing(RUN, 2, flown.span_ratio[1])) == []
    assert "first state of bird_02" in bird.waiting_for
    (report,) = bird.receive_stage(start_of(2, flown))
    assert Progress.decode(report[1]).step == 0
    assert bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH)) == []
    assert bird.due == math.inf
    bird.receive_grant(grant(flown, 7))
    while bird.due < math.inf:
        out = bird.tick(max(bird.due, BEGIN))
    assert bird.step == 7
    assert Progress.decode(of(Channel.PROGRESS, out)[0]).step == 6  # so that leave is renewed
    assert "grant beyond step 7" in bird.waiting_for
    bird.receive_grant(grant(flown, 20))
    while bird.due < math.inf:
        bird.tick(bird.due)
    assert bird.finished
    assert not bird.released
    bird.receive_grant(grant(flown, 21))
    assert bird.released


@pytest.mark.parametrize(
    "distance", [-5, -REACH, -REACH - 1, REACH + 1, -(2**30), 2**30, 2**31 - 1, 2**31]
)
def test_a_free_flight_is_not_ended_by_forged_epochs_out_of_reach_or_out_of_date(
    distance: int,
) -> None:
    flown, epoch = FlockConfiguration(birds=2, t_max=20.0), 2**31 + 3
    bird = ready(1, flown)
    bird.receive_grant(grant(flown, 0, epoch))
    bird.receive_grant(grant(flown, 0, epoch))  # from EPOCH it is out of reach
    bird.receive_grant(grant(flown, 20, epoch))
    assert bird.in_flight
    for _ in range(5):
        assert bird.receive_grant(grant(flown, 0, (epoch + distance) % 2**32)) == []
    assert bird.ignored == 1 + 5


def test_a_new_epoch_before_the_start_changes_nothing_and_after_it_ends_the_flight() -> None:
    flown = FlockConfiguration(birds=2, t_max=20.0)
    bird = ready(1, flown)
    out = bird.receive_grant(grant(flown, 0, EPOCH + 1))
    reached = [Progress.decode(data) for data in of(Channel.PROGRESS, out)]
    assert [(told.epoch, told.step) for told in reached] == [(EPOCH + 1, -1), (EPOCH + 1, 0)]
    bird.receive_grant(grant(flown, 20, EPOCH + 1))
    assert bird.receive_grant(grant(flown, 0, EPOCH)) == []
    # One message is not enough: a clock that begins anew says so every second.
    assert bird.receive_grant(grant(flown, 0, EPOCH + 2)) == []
    assert bird.ignored_for == {STALE: 1, REPEATED: 1}
    with pytest.raises(RunFailed, match=r"bird_01: .* fly again"):
        bird.receive_grant(grant(flown, 0, EPOCH + 2))


def test_a_bird_that_comes_to_a_flight_in_flight_does_not_begin() -> None:
    flown = FlockConfiguration(birds=2, t_max=20.0)
    bird = FreeBird(1, flown, FACTOR)
    bird.receive_grant(grant(flown, 10))
    bird.receive_wing(Wing(RUN, 2, flown.span_ratio[1]))
    assert bird.receive_stage(start_of(2, flown)) == []
    assert bird.due == math.inf


def test_a_clock_of_another_pace_or_in_lockstep_is_refused() -> None:
    flown = FlockConfiguration(birds=2, t_max=20.0)
    for said_terms in (handshake(flown), handshake(flown, 3.0)):
        bird, other = FreeBird(1, flown, FACTOR), replace(grant(flown, 0), terms=said_terms)
        assert bird.receive_grant(other) == []
        with pytest.raises(FlockError, match="real_time_factor = 2"):
            bird.receive_grant(other)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (said(2, 1, (0.0, 1.0, 1.0), EPOCH - 1), STALE),
        (said(2, 1, (0.0, 1.0, 1.0), EPOCH + 1), REPEATED),
        (said(2, 0, (0.0, 1.0, 1.0)), AGAIN),
        (said(2, 0, (0.0, math.nan, 1.0)), IMPOSSIBLE),
        (said(2, 21, (0.0, 1.0, 1.0)), REPEATED),
        (said(2, 1, ([0.0, 1.0], [1.0, 1.0], [1.0, 1.0])), MISSHAPEN),
        (said(3, 1, (0.0, 1.0, 1.0)), "not from a neighbour"),
        (said(2, 1, (0.0, 1.0, 1.0))[:-9], "that can't be read"),
    ],
)
def test_what_is_not_for_it_changes_nothing_and_is_counted(data: bytes, reason: str) -> None:
    bird = ready(1, FlockConfiguration(birds=3, t_max=20.0))
    assert bird.receive_stage(data, BEGIN) == []
    assert bird.ignored_for == {reason: 1}


@pytest.mark.parametrize("link", ["hold:delay=1", "linear:interval=2", "exact:drop=0.1"])
def test_what_only_lockstep_can_do_is_refused(link: str) -> None:
    with pytest.raises(FlockError, match="leave out all but"):
        check_free(FlockConfiguration(links=(link,)), 1.0, 60.0, False)


def test_a_step_that_lasts_as_long_as_a_standstill_is_refused() -> None:
    flown = FlockConfiguration()
    check_free(flown, flown.second / 29.9, 60.0, False)
    with pytest.raises(FlockError, match="half of the timeout"):
        check_free(flown, flown.second / 30.1, 60.0, False)


def test_its_clock_gives_all_leave_at_once_and_can_not_go_back() -> None:
    flown = FlockConfiguration(birds=2, t_max=500.0)
    clock = Timekeeper(flown, RUN, 1, False, epoch=EPOCH, factor=FACTOR)
    clock.receive(Progress(RUN, 0, EPOCH, "bird_01", 1))
    (leave,) = [m for m in clock.receive(Progress(RUN, 0, EPOCH, "bird_02", 2))
                if isinstance(m, Grant)]  # fmt: skip
    assert (leave.step, leave.terms) == (500, handshake(flown, FACTOR))
    assert not clock.lost
    clock.receive(Progress(RUN, -1, EPOCH, "bird_02", 3))
    assert not clock.lost, "a bird that has come back says so again"
    clock.receive(Progress(RUN, -1, EPOCH, "bird_02", 3))
    assert clock.lost
