# SPDX-License-Identifier: Apache-2.0
"""The rate is that at which steps are sent, however late they are seen."""

from __future__ import annotations

import pytest

from flock_tools.live.step_rate import RATE_OVER, StepRate

EVERY = 10
"""Steps between two that are seen."""


@pytest.mark.parametrize("true", [2.0, 24.0, 467.0])
@pytest.mark.parametrize("seen_within", [0.0, 0.01, 0.2])
def test_steps_that_are_seen_all_at_once_have_the_rate_at_which_they_were_sent(
    true: float, seen_within: float
) -> None:
    rate = StepRate()
    for k in range(64):
        rate.see(k * EVERY, k * EVERY / true, 1000.0 + seen_within * k / 64)
    assert rate.at(1000.0 + seen_within) == pytest.approx(true)


def test_the_rate_goes_on_after_the_steps_before() -> None:
    rate, true = StepRate(), 24.0
    for k in range(64):
        rate.see(k * EVERY, k * EVERY / true, 63 * EVERY / true)
    for k in range(64, 128):
        sent = k * EVERY / true
        rate.see(k * EVERY, sent, sent)
        assert rate.at(sent) == pytest.approx(true)


def test_a_flock_that_stands_still_has_no_rate() -> None:
    rate = StepRate()
    for k in range(3):
        rate.see(k * EVERY, 0.1 * k, 0.2)
    told = []
    for n in range(20):
        now = 0.2 + 0.25 * n
        rate.see(2 * EVERY, 0.2, now)
        told.append(rate.at(now))
    assert told[0] == pytest.approx(100.0)
    assert told == sorted(told, reverse=True)  # type: ignore[type-var]
    assert told[-1] == 0.0


def test_one_step_has_no_rate_and_a_step_back_begins_anew() -> None:
    rate = StepRate()
    assert rate.at(0.0) is None
    for step, sent in ((50, 0.0), (60, 1.0), (20, 2.0)):
        rate.see(step, sent, sent)
    assert rate.at(2.0) is None


def test_the_steps_of_long_ago_take_no_room() -> None:
    rate = StepRate()
    for k in range(10_000):
        rate.see(k, 0.1 * k, 0.1 * k)
    assert len(rate._seen) <= 2 + RATE_OVER / 0.1
