# SPDX-License-Identifier: Apache-2.0
"""The draining loop: it stays awake while messages are received, and times out without any."""

from __future__ import annotations

import pytest

from flock_sim.errors import RunFailed
from flock_sim.ros import spin
from flock_sim.ros.spin import keep_flying
from flock_sim.ros.watchdog import Watchdog

pytestmark = pytest.mark.ros


class EveryOther:
    """A bird to which a message comes at every other look."""

    def __init__(self, messages: int) -> None:
        self.left = messages
        self.looks = 0

    def drain(self) -> bool:
        self.looks += 1
        came = self.looks % 2 == 0 and self.left > 0
        self.left -= came
        return came

    def drain_rare(self) -> bool:
        return False

    def report(self) -> None:
        pass

    @property
    def finished(self) -> bool:
        return self.left == 0

    @property
    def waiting_for(self) -> str:
        return "it waits for a message"


class Link:
    """A bird of a chain: it goes on once its neighbours have come as far as it has."""

    def __init__(self, chain: list[Link], end: int) -> None:
        self.chain, self.at, self.end = chain, len(chain), end
        self.stage = self.runs = 0
        chain.append(self)

    def drain(self) -> bool:
        near = self.chain[max(0, self.at - 1) : self.at + 2]
        moves = self.stage < min(self.end, 1 + min(link.stage for link in near))
        self.stage += moves
        return moves

    def drain_rare(self) -> bool:
        self.runs += 1
        return False

    def report(self) -> None:
        raise AssertionError("nobody has to wait")

    @property
    def finished(self) -> bool:
        return self.stage == self.end

    @property
    def waiting_for(self) -> str:
        return f"stage {self.stage} of a neighbour"


class Executor:
    """Counts how often it was asked to wait, and to serve what is there."""

    def __init__(self) -> None:
        self.waits = self.polls = 0

    def spin_once(self, timeout_sec: float) -> None:
        if timeout_sec > 0.0:
            self.waits += 1
        else:
            self.polls += 1


def test_the_executor_does_not_wait_while_messages_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spin, "FRUITLESS_SWEEPS", 3)
    executor = Executor()
    bird = EveryOther(10_000)
    keep_flying([bird], executor, 0, Watchdog(1e9, print))
    assert bird.finished
    assert executor.waits == 0
    assert executor.polls >= 1  # parameters and the like are served in flight


@pytest.mark.parametrize("birds", [spin.GROUP + 1, 301])
def test_of_many_birds_each_gets_far_at_a_turn(birds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spin, "RARELY", 1)  # each turn is counted
    chain: list[Link] = []
    for _ in range(birds):
        Link(chain, end=400)
    executor = Executor()
    keep_flying(chain, executor, 0, Watchdog(1e9, print))
    assert all(link.finished for link in chain)
    assert executor.waits == 0
    rounds = chain[0].runs
    assert 400 / rounds >= 8  # stages in a round over all groups


def test_what_comes_rarely_is_looked_for_rarely_but_before_the_executor_waits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(spin, "FRUITLESS_SWEEPS", 3)
    chain: list[Link] = []
    for _ in range(3):
        Link(chain, end=1600)
    rare: list[int] = []
    around: list[int] = []

    def look_around() -> bool:
        around.append(chain[0].stage)
        return False

    def drain_rare() -> bool:
        rare.append(chain[0].stage)
        return False

    chain[0].drain_rare = drain_rare  # type: ignore[method-assign]
    keep_flying(chain, Executor(), 0, Watchdog(1e9, print), look_around)
    assert len(around) >= 1600 / spin.SWEEPS
    assert 1600 / (spin.SWEEPS * spin.RARELY) - 1 <= len(rare) <= len(around) / spin.RARELY + 1

    waiting = EveryOther(1)
    waiting.drain = lambda: False  # type: ignore[method-assign]

    def at_last() -> bool:
        waiting.left = 0
        return True

    monkeypatch.setattr(spin, "RARELY", 10**9)
    waiting.drain_rare = at_last  # type: ignore[method-assign]
    keep_flying([waiting], Executor(), 0, Watchdog(2.0, print))
    assert waiting.finished


def test_a_bird_that_hears_nothing_gives_up_and_says_what_it_waits_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(spin, "FRUITLESS_SWEEPS", 3)
    bird = EveryOther(1)
    bird.drain = lambda: False  # type: ignore[method-assign]
    with pytest.raises(RunFailed, match="it waits for a message"):
        keep_flying([bird], Executor(), 0, Watchdog(0.01, print))


def test_a_bird_that_waits_sleeps_so_that_others_can_fly(monkeypatch: pytest.MonkeyPatch) -> None:
    """To give the processor away is not enough: processes of other sessions do not get it."""
    given: list[str] = []
    monkeypatch.setattr(spin.os, "sched_yield", lambda: given.append("yield"))
    monkeypatch.setattr(spin.time, "sleep", lambda seconds: given.append(f"sleep {seconds}"))
    bird = EveryOther(1)
    bird.drain = lambda: False  # type: ignore[method-assign]
    with pytest.raises(RunFailed):
        keep_flying([bird], Executor(), 0, Watchdog(0.01, print))
    waited = spin.FRUITLESS_SWEEPS - 1
    slept = [f"sleep {spin.NAP}"] * (waited - spin.YIELDS)
    assert given[:waited] == ["yield"] * spin.YIELDS + slept
