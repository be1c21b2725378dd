# SPDX-License-Identifier: Apache-2.0
"""A signal that ends a process is never lost, at any time."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator

import pytest

from flock_sim.console.signals import ENDING, INSISTENCE, Ended, Endings, ending_deferred


@pytest.fixture(autouse=True)
def own_handlers() -> Iterator[list[int]]:
    """Handlers of the test for SIGTERM and SIGHUP; that of SIGINT is Python's."""
    before = {number: signal.getsignal(number) for number in ENDING}
    heard: list[int] = []
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, frame: heard.append(number))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield heard
    for number, handler in before.items():
        signal.signal(number, handler)


def test_an_interrupt_is_heard_after_the_block() -> None:
    passed = []

    def interrupted() -> None:
        with ending_deferred():
            os.kill(os.getpid(), signal.SIGINT)
            passed.append(True)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert passed


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_kill_is_heard_after_the_block(own_handlers: list[int], number: int) -> None:
    with ending_deferred():
        os.kill(os.getpid(), number)
        assert own_handlers == []
    assert own_handlers == [number]


def test_an_interrupt_that_is_ignored_stays_so() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with ending_deferred():
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_what_the_block_raises_is_raised() -> None:
    with pytest.raises(ValueError, match="this"), ending_deferred():
        raise ValueError("this")
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler


@pytest.mark.parametrize("number", ENDING)
@pytest.mark.parametrize("presses", [1, 2, 5])
def test_a_tool_is_ended_once_however_often_it_is_told(number: int, presses: int) -> None:
    done = []

    def ended() -> None:
        with Endings():
            try:
                os.kill(os.getpid(), number)
            finally:
                for _ in range(presses - 1):
                    os.kill(os.getpid(), number)
                done.append(True)

    with pytest.raises(Ended) as raised:
        ended()
    os.kill(os.getpid(), number)  # nor is the end of Python disturbed
    assert done
    assert raised.value.status == 128 + number


def test_a_signal_that_is_deferred_is_raised_where_it_is_looked_for() -> None:
    with Endings() as endings, endings.deferred():
        endings.check()
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(Ended):
            endings.check()
    signal.raise_signal(signal.SIGTERM)  # the handler of the test, as before


def test_a_tool_whose_end_hangs_is_ended_by_another_signal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    with Endings():
        with pytest.raises(Ended):
            os.kill(os.getpid(), signal.SIGINT)
        now += 0.9 * INSISTENCE
        os.kill(os.getpid(), signal.SIGINT)
        now += INSISTENCE
        with pytest.raises(Ended):
            os.kill(os.getpid(), signal.SIGINT)


def test_what_is_ignored_by_a_process_from_its_start_stays_so() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with Endings():
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
