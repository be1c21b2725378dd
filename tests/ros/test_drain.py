# SPDX-License-Identifier: Apache-2.0
"""The loop that drains: it stays awake while messages flow, and gives up when none do."""

from __future__ import annotations

import pytest

from flock_sim.errors import RunFailed
from flock_sim.nodes import drain
from flock_sim.nodes.drain import keep_flying
from flock_sim.nodes.patience import Patience

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
    """Counts how often it was asked to wait."""

    def __init__(self) -> None:
        self.waits = 0

    def spin_once(self, timeout_sec: float) -> None:
        self.waits += 1


def test_the_executor_does_not_wait_while_messages_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drain, "FRUITLESS_SWEEPS", 3)
    executor = Executor()
    bird = EveryOther(10_000)
    keep_flying([bird], executor, 0, Patience(1e9, print))
    assert bird.finished
    assert executor.waits == 0


@pytest.mark.parametrize("birds", [drain.TOGETHER + 1, 2 * drain.TOGETHER + 45])
def test_of_many_birds_each_gets_far_at_a_turn(birds: int) -> None:
    chain: list[Link] = []
    for _ in range(birds):
        Link(chain, end=400)
    executor = Executor()
    keep_flying(chain, executor, 0, Patience(1e9, print))
    assert all(link.finished for link in chain)
    assert executor.waits == 0
    rounds = chain[0].runs
    assert 400 / rounds >= 8  # stages in a round over all groups


def test_a_bird_that_hears_nothing_gives_up_and_says_what_it_waits_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(drain, "FRUITLESS_SWEEPS", 3)
    bird = EveryOther(1)
    bird.drain = lambda: False  # type: ignore[method-assign]
    with pytest.raises(RunFailed, match="it waits for a message"):
        keep_flying([bird], Executor(), 0, Patience(0.01, print))
