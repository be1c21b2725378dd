# SPDX-License-Identifier: Apache-2.0
"""A snapshot of a flock is one step of it, unchanged, for any order of messages."""

from __future__ import annotations

import json

import numpy as np
import pytest

from flock_sim.analysis.metrics import measure
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.handshake import handshake
from flock_sim.messages.types import Grant, State, Wing
from flock_sim.physics.flock_state import FlockState
from flock_tools.live.flock_monitor import SILENT, View
from flock_tools.live.players import Publisher

FLOCK = FlockConfiguration(birds=3, span_ratios=("1=0.9,1.0",), t_max=100.0)

OTHER = FlockConfiguration(birds=5, coupling="all", t_max=50.0)


def values(step: int) -> np.ndarray:
    """Return the ARRAYS of a state, shape (6, birds, members)."""
    return np.random.default_rng(step).normal(size=(6, 3, 2))


def state(bird: int, step: int, run: int = 0) -> bytes:
    return State.at(FLOCK, step, *values(step)[:, bird - 1], run_id=run).encode()


def grant(run: int, flock: FlockConfiguration = FLOCK, factor: float = 0.0) -> bytes:
    return Grant(run, 0, flock.steps, flock.dt, 1, handshake(flock, factor)).encode()


class Observer:
    """A view whose clock is set."""

    def __init__(self) -> None:
        self.time = 5.0
        self.view = View(lambda: self.time)

    def hear(self, *birds: int, step: int, run: int = 0) -> None:
        for bird in birds:
            self.view.hear_state(bird, state(bird, step, run))

    def step(self) -> int | None:
        sample = self.view.sample({1, 2, 3}, 1)
        return sample.step if sample else None


def test_the_sample_is_what_metrics_say_of_the_step() -> None:
    observer = Observer()
    observer.view.hear_grant(grant(7))
    observer.hear(3, 1, 2, step=20)
    state = FlockState(20, 20.0, *values(20))
    expected = measure(FLOCK, state)
    for m in range(2):
        sample = observer.view.sample({1}, m + 1)
        assert sample is not None
        assert sample.position == expected.position[m].tolist()
        assert sample.drag_reduction == expected.drag_reduction[m].tolist()
        assert sample.speed == state.speed[:, m].tolist()
        assert (sample.step, sample.time, sample.end, sample.leader) == (20, 20.0, 100, 2)
        assert sample.hears == [[2], [1, 3], [2]]
    with pytest.raises(FlockError, match=r"--member 3: must be in 1\.\.2"):
        observer.view.sample({1}, 3)


@pytest.mark.parametrize("run", [0, 7])  # played, flown
@pytest.mark.parametrize("factor", [0.0, 2.0])
def test_a_free_flight_is_shown_with_all_that_its_clock_tells(factor: float, run: int) -> None:
    observer = Observer()
    observer.view.hear_grant(grant(7, factor=factor))
    observer.hear(1, 2, 3, step=20, run=run)
    sample = observer.view.sample({1}, 1)
    assert sample is not None
    assert (sample.coupling, sample.end, sample.real_time_factor) == ("nearest", 100, factor)
    expected = measure(FLOCK, FlockState(20, 20.0, *values(20)))
    assert sample.drag_reduction == expected.drag_reduction[0].tolist()


def test_a_configuration_that_cannot_be_read_is_not_passed_over_in_silence() -> None:
    observer = Observer()
    terms = json.dumps({**FLOCK.parameters(), "wind": 1.0})
    observer.view.hear_grant(Grant(7, 0, 100, 1.0, 1, terms).encode())
    observer.hear(1, 2, 3, step=20, run=7)
    sample = observer.view.sample({1, 2, 3}, 1)
    assert sample is not None
    assert sample.coupling is None
    assert "unknown parameter 'wind'" in observer.view.unreadable
    observer.view.hear_grant(grant(7))
    assert observer.view.unreadable == ""


def test_only_steps_of_which_all_was_heard_are_shown() -> None:
    observer = Observer()
    observer.hear(1, 2, step=10)
    assert observer.step() is None
    observer.hear(3, step=10)
    observer.hear(1, 2, step=20)
    assert observer.step() == 10
    observer.hear(3, step=20)
    assert observer.step() == 20


def test_a_flock_that_goes_back_is_followed() -> None:
    observer = Observer()
    observer.hear(1, 2, 3, step=50)
    assert observer.step() == 50
    observer.hear(1, 2, 3, step=10)
    assert observer.step() == 10


def test_rate_and_ages_are_those_of_the_clock() -> None:
    observer = Observer()
    observer.hear(1, 2, 3, step=0)
    first = observer.view.sample({3}, 1)
    assert first is not None
    assert (first.rate, first.age, first.drag_reduction) == (None, [0.0] * 3, None)
    observer.time += 0.5
    observer.hear(1, 2, 3, step=100)
    observer.hear(1, step=110)
    observer.time += 0.25
    second = observer.view.sample({3}, 1)
    assert second is not None
    assert second.age == [0.25] * 3
    assert second.rate == pytest.approx(100 / 0.75)


@pytest.mark.parametrize("sampled", [False, True])  # while the states of the past are received
def test_states_of_the_past_are_no_progress_of_now(sampled: bool) -> None:
    observer, true, every = Observer(), 24.0, 10
    for k in range(64):
        for bird in (1, 2, 3):
            age = 0.1 + (63 - k) * every / true
            observer.view.hear_state(bird, state(bird, k * every), age)
            observer.time += 1e-4
        if sampled:
            observer.step()
    shown = observer.view.sample({1, 2, 3}, 1)
    assert shown is not None
    assert shown.step == 63 * every
    assert shown.rate == pytest.approx(true, rel=0.01)
    assert shown.age == pytest.approx([0.1] * 3, abs=0.001)
    assert observer.view.behind == pytest.approx(0.1, abs=0.001)


def test_the_time_that_decoding_takes_makes_no_state_younger(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    observer, decode = Observer(), State.decode

    def slow(data: bytes) -> State:
        observer.time += 1.0
        return decode(data)

    monkeypatch.setattr(State, "decode", slow)
    for bird in (1, 2, 3):
        observer.view.hear_state(bird, state(bird, 0), 0.5)
    shown = observer.view.sample({1, 2, 3}, 1)
    assert shown is not None
    assert shown.age == [3.5, 2.5, 1.5]


def test_a_clock_that_is_fast_makes_no_message_younger_than_nothing() -> None:
    observer = Observer()
    for bird in (1, 2, 3):
        observer.view.hear_state(bird, state(bird, 0), -5.0)
    shown = observer.view.sample({3}, 1)
    assert shown is not None
    assert shown.age == [0.0] * 3


def test_a_flock_that_is_played_again_has_no_negative_rate() -> None:
    observer = Observer()
    for step in (80, 100):
        observer.hear(1, 2, 3, step=step)
        assert observer.view.sample({3}, 1) is not None
        observer.time += 0.5
    rates = []
    for step in (0, 20, 40):
        observer.hear(1, 2, 3, step=step)
        sample = observer.view.sample({3}, 1)
        assert sample is not None
        rates.append(sample.rate)
        observer.time += 0.5
    assert rates == [None, 40.0, 40.0]


@pytest.mark.parametrize("with_grant", [False, True])
def test_states_of_other_lengths_are_none_of_the_flock(with_grant: bool) -> None:
    observer = Observer()
    if with_grant:
        observer.view.hear_grant(grant(7))
    observer.hear(1, 2, 3, step=10)
    lengths = [(2, 2, 2, 1), (1, 2, 2, 2), (3, 2, 2, 2), (2, 0, 2, 2), (0, 0, 0, 0), (1, 1, 1, 1)]
    lengths += [(2, 2, 2, 2, 1, 2), (2, 2, 2, 2, 2, 3)]
    for k, each in enumerate(lengths):
        arrays = [np.ones(length) for length in (*each, 2, 2)[:6]]
        odd = State.at(FLOCK, 20 + k, *arrays, run_id=0).encode()
        observer.hear(1, 3, step=20 + k)
        observer.view.hear_state(2, odd)
        for member in (1, 2):
            sample = observer.view.sample({1, 2, 3}, member)
            assert sample is not None
            assert (sample.step, sample.members) == (10, 2)
    observer.hear(1, 2, 3, step=50)
    assert observer.step() == 50


def test_a_bird_that_is_none_of_the_flock_hides_nothing() -> None:
    observer = Observer()
    observer.view.hear_grant(grant(7))
    for bird in (0, 4, 10**9):
        observer.view.hear_state(bird, state(1, 10))
    observer.hear(1, 2, 3, step=10)
    sample = observer.view.sample({1, 2, 3, 4, 10**9}, 1)
    assert sample is not None
    assert (sample.birds, sample.step) == (3, 10)


def test_another_run_is_watched_once_the_first_is_silent() -> None:
    observer = Observer()
    observer.hear(1, 2, 3, step=10, run=1)
    observer.hear(1, 2, 3, step=90, run=2)
    assert observer.step() == 10
    observer.time += SILENT
    observer.hear(1, 2, 3, step=20, run=2)
    assert observer.step() == 20


def test_two_flights_at_once_do_not_hide_each_other() -> None:
    observer = Observer()
    observer.view.hear_grant(grant(1))
    observer.hear(1, 2, 3, step=10, run=1)
    for step in (20, 30, 40):
        observer.view.hear_grant(grant(2, OTHER))
        for bird in range(1, 6):
            observer.view.hear_state(bird, state(1 + bird % 3, step, run=2))
        observer.hear(1, 2, 3, step=step, run=1)
        sample = observer.view.sample(range(1, 6), 1)
        assert sample is not None
        assert (sample.birds, sample.step, sample.coupling) == (3, step, "nearest")
        observer.view.hear_grant(grant(1))


def test_wings_of_two_flights_are_kept_apart() -> None:
    observer = Observer()
    row = [State.decode(state(bird, 10, run=1)) for bird in (1, 2, 3)]
    observer.hear(1, 2, 3, step=10, run=1)
    for run, ratio in ((1, 0.9), (2, 1.1)):
        for bird in (1, 2, 3):
            observer.view.hear_wing(bird, Wing(run, bird, np.full(2, ratio)).encode())
    found = observer.view.span_ratio(row)
    assert found is not None
    assert found.tolist() == [[0.9, 0.9]] * 3


def test_a_flight_of_rare_states_is_watched_as_long_as_its_clock_grants() -> None:
    observer = Observer()
    observer.hear(1, 2, 3, step=10, run=1)
    for step in (20, 30, 40):
        observer.time += 0.9 * SILENT
        observer.view.hear_grant(grant(1))
        observer.hear(1, 2, 3, step=step, run=2)
        assert observer.step() == 10
    observer.time += 0.9 * SILENT
    observer.hear(1, 2, 3, step=20, run=1)
    assert observer.step() == 20


def test_what_another_flight_sent_before_it_is_watched_is_not_lost() -> None:
    observer = Observer()
    observer.hear(1, 2, 3, step=10, run=1)
    observer.time += 0.5 * SILENT
    observer.hear(1, 2, 3, step=90, run=2)
    observer.time += 0.6 * SILENT
    assert observer.step() == 90


def test_a_step_is_not_put_together_from_two_epochs() -> None:
    observer = Observer()
    observer.hear(1, 2, 3, step=10)
    observer.hear(1, 2, step=20)
    again = State.at(FLOCK, 20, *values(99)[:, 2], epoch=2).encode()
    observer.view.hear_state(3, again)
    assert observer.step() == 10


def test_many_runs_take_no_more_room_than_some() -> None:
    observer = Observer()
    observer.view.hear_grant(grant(7))
    observer.hear(1, 2, 3, step=10, run=7)
    for run in range(100, 200):
        observer.hear(1, 2, 3, step=50, run=run)
        observer.view.hear_grant(grant(run, OTHER))
    assert observer.step() == 10
    assert observer.view.flown == FLOCK


def test_a_played_flock_is_not_taken_for_the_flight_before() -> None:
    observer = Observer()
    observer.view.hear_grant(grant(7, OTHER))  # of five birds
    observer.hear(1, 2, 3, step=10, run=7)
    observer.view.hear_wing(1, Wing(7, 1, np.ones(2)).encode())
    observer.time += SILENT
    observer.hear(1, 2, 3, step=20)  # from a bag of `reference`, without grants
    sample = observer.view.sample({1, 2, 3}, 1)
    assert sample is not None
    assert (sample.birds, sample.coupling, sample.end) == (3, None, None)
    assert observer.view.span_ratio([State.decode(state(1, 20))]) is None


PLAYER, NEXT = Publisher("/flock/player", (1,)), Publisher("/flock/player", (2,))


def test_a_played_flock_is_not_taken_for_the_one_played_before() -> None:
    observer = Observer()
    observer.view.see_publishers(dict.fromkeys((1, 2, 3), (PLAYER,)), [PLAYER])
    observer.view.hear_grant(grant(7))
    observer.hear(1, 2, 3, step=10)
    observer.hear(1, step=20)
    assert observer.step() == 10
    assert observer.view.flown == FLOCK
    observer.time += 0.25
    observer.view.see_publishers({}, [])
    assert observer.step() == 10
    observer.time += 0.25
    observer.view.see_publishers(dict.fromkeys((1, 2), (NEXT,)), [])
    assert observer.view.flown is None
    observer.hear(2, step=20)
    assert observer.step() is None  # no row is made of both
    observer.hear(1, 2, step=0)
    sample = observer.view.sample({1, 2, 3}, 1)
    assert sample is not None
    assert (sample.birds, sample.step, sample.coupling) == (2, 0, None)


def test_the_grant_of_a_flight_goes_with_its_bag_but_not_with_another_one() -> None:
    observer = Observer()
    observer.view.see_publishers({1: [Publisher("/flock/bird_01", (1,))]}, [PLAYER])
    observer.view.hear_grant(grant(7))
    observer.hear(1, 2, 3, step=10, run=7)
    observer.time += SILENT
    observer.view.see_publishers({}, [])
    observer.time += 0.25
    observer.view.hear_grant(grant(7))  # played, by a player that is discovered afterwards
    observer.hear(1, 2, 3, step=20)
    observer.view.see_publishers(dict.fromkeys((1, 2, 3), (NEXT,)), [NEXT])
    assert observer.step() == 20
    assert observer.view.flown == FLOCK


def test_a_flight_at_the_same_time_does_not_lend_its_grant_to_a_played_flock() -> None:
    observer = Observer()
    observer.view.see_publishers(dict.fromkeys((1, 2, 3), (PLAYER,)), [PLAYER])
    observer.hear(1, 2, 3, step=10)
    observer.view.hear_grant(grant(7))
    observer.hear(1, 2, 3, step=30, run=8)
    observer.view.hear_grant(grant(8, OTHER))
    assert observer.view.flown == FLOCK
    assert observer.step() == 10


def test_a_played_flock_has_the_birds_that_are_played() -> None:
    observer = Observer()
    publishers = {bird: [Publisher(f"/flock/bird_{bird:02d}", (9,))] for bird in range(1, 6)}
    for bird in (1, 2, 3):
        publishers[bird].append(PLAYER)
    observer.view.see_publishers(publishers, [])
    observer.hear(1, 2, 3, step=10)
    sample = observer.view.sample(range(1, 6), 1)
    assert sample is not None
    assert sample.birds == 3


def test_what_is_no_message_changes_nothing() -> None:
    observer = Observer()
    observer.view.hear_grant(b"")
    observer.view.hear_grant(Grant(7, 0, 100, 1.0, 1, "[1]").encode())
    observer.view.hear_state(1, b"\0\1\0\0")
    assert observer.view.sample(set(), 1) is None
