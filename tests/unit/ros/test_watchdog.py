# SPDX-License-Identifier: Apache-2.0
"""Every wait has an end, and time in which the process was stopped does not count."""

from __future__ import annotations

import time

import pytest

from flock_sim.errors import RunFailed
from flock_sim.ros.watchdog import LONGEST_LOOK, Watchdog


class Hours:
    """A clock in the hands of the test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now)


def test_a_wait_ends_and_says_what_it_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    hours, said = Hours(monkeypatch), list[str]()
    watchdog = Watchdog(8.0, said.append)
    for _ in range(79):
        hours.now += 0.1
        watchdog.wait(lambda: "waiting for bird_02")
    assert said == ["waiting for bird_02 (timeout in 4 s)"]
    hours.now += 0.2
    with pytest.raises(RunFailed, match="no progress for 8 s, waiting for bird_02"):
        watchdog.wait(lambda: "waiting for bird_02")


@pytest.mark.parametrize("stopped", [10.0, 3600.0, 1e6])
def test_time_in_which_the_process_was_stopped_does_not_count(
    monkeypatch: pytest.MonkeyPatch, stopped: float
) -> None:
    hours = Hours(monkeypatch)
    watchdog = Watchdog(8.0, lambda line: None)
    for _ in range(5):
        hours.now += stopped  # Ctrl-Z, and fg
        watchdog.wait(lambda: "nothing")
    assert watchdog.silence == pytest.approx(5 * LONGEST_LOOK)
    assert watchdog.half_elapsed


def test_what_is_heard_begins_the_wait_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    hours = Hours(monkeypatch)
    watchdog = Watchdog(2.0, lambda line: None)
    for _ in range(10):
        hours.now += 0.9
        watchdog.wait(lambda: "nothing")
        watchdog.reset()
    assert watchdog.silence == 0.0
