# SPDX-License-Identifier: Apache-2.0
"""The measured parts of a bird process's time add up to the whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from flock_sim.errors import FlockError
from flock_sim.ros import stopwatch
from flock_sim.ros.stopwatch import Stopwatch
from flock_sim.ros.time_breakdown import TimeBreakdown
from flock_tools.experiments.flown_limits import recorded_every


class Watch:
    """The time, which stands still unless somebody works."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Bird:
    """Works, and looks around in vain, for known times."""

    finished, waiting_for = False, "nobody"

    def __init__(self, time: Watch, watch: Stopwatch) -> None:
        self.time = time
        self.kernel = watch.around(self.compute)
        self.moves = True

    def compute(self, *arguments: object) -> None:
        self.time.now += 2.0

    def drain(self) -> bool:
        self.time.now += 0.5
        if self.moves:
            self.kernel(*[None] * 7)  # type: ignore[arg-type]
            self.time.now += 0.25
        return self.moves

    def drain_rare(self) -> bool:
        self.time.now += 10.0
        return False

    def report(self) -> None:
        self.time.now += 1.0


def test_kernel_messages_and_waiting_are_all_of_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    time, watch = Watch(), Stopwatch()
    monkeypatch.setattr(stopwatch, "perf_counter", time)
    bird = Bird(time, watch)
    watched, look = watch.watched(bird), lambda: watch.fruitful(bird.drain)
    assert not watched.drain_rare()  # before the first stage: no part of the flight
    assert watch.times == TimeBreakdown(0.0, 0.0, 0.0)
    assert watched.drain()  # its first 0.5 s, too
    assert not watched.drain_rare()
    watched.report()
    bird.moves = False
    assert not watched.drain()
    bird.moves = True
    assert look()
    # Stages: 2 s each. Messages: 0.25 s after each, 0.5 s before the second. Waiting: 11.5 s,
    # less the 0.25 s after the last stage, with which the flight ends.
    assert watch.times == TimeBreakdown(4.0, 1.0, 11.25)


def test_times_of_processes_are_summed_and_shared_out(tmp_path: Path) -> None:
    TimeBreakdown(1.0, 2.0, 3.0).write(tmp_path / "a.json")
    TimeBreakdown(3.0, 0.0, 1.0).write(tmp_path / "b.json")
    total = TimeBreakdown.sum(map(TimeBreakdown.read, sorted(tmp_path.iterdir())))
    assert total == TimeBreakdown(4.0, 2.0, 4.0)
    assert total.shares() == {"kernel": 0.4, "messages": 0.2, "waiting": 0.4}
    assert set(TimeBreakdown.sum([]).shares().values()) == {0.0}
    with pytest.raises(FlockError, match="can't be written"):
        total.write(tmp_path / "missing" / "c.json")


@pytest.mark.parametrize(
    ("steps", "every"),
    [(1, 1), (7, 1), (20, 1), (100000, 5000), (23, 23), (46, 23), (10007, 10007)],
)
def test_the_last_step_is_among_few_that_are_recorded(steps: int, every: int) -> None:
    assert recorded_every(steps) == every
