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


def test_a_bird_that_hears_nothing_gives_up_and_says_what_it_waits_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(drain, "FRUITLESS_SWEEPS", 3)
    bird = EveryOther(1)
    bird.drain = lambda: False  # type: ignore[method-assign]
    with pytest.raises(RunFailed, match="it waits for a message"):
        keep_flying([bird], Executor(), 0, Patience(0.01, print))
