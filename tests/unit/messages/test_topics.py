# SPDX-License-Identifier: Apache-2.0
"""States are fetched as late as possible, but never so late that a flock waits."""

from __future__ import annotations

import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.topics import (
    FASTEST,
    LONGEST_FETCH,
    SHORTEST_FETCH,
    fetch_period,
    steps_ahead,
)


@pytest.mark.parametrize(
    ("birds", "every", "members", "period"),
    [
        (13, 10, 1, 0.1),
        (101, 10, 1, LONGEST_FETCH),
        (501, 10, 1, LONGEST_FETCH),
        (2, 10, 1, SHORTEST_FETCH),
        (2, 1, 1, 0.0),
        (13, 1, 287, 0.0),
    ],
)
def test_large_flocks_fetch_rarely(birds: int, every: int, members: int, period: float) -> None:
    ratios = (f"1={','.join(['1.0'] * members)}",)
    flock = FlockConfiguration(birds=birds, record_every=every, span_ratios=ratios)
    assert fetch_period(flock) == period


@pytest.mark.parametrize("members", [1, 3, 30, 300])
@pytest.mark.parametrize("every", [1, 2, 10, 1000])
@pytest.mark.parametrize("birds", [1, 3, 13, 101, 501])
def test_a_flock_never_comes_to_the_end_of_its_room_between_two_fetches(
    birds: int, every: int, members: int
) -> None:
    ratios = (f"1={','.join(['1.0'] * members)}",)
    flock = FlockConfiguration(birds=birds, record_every=every, span_ratios=ratios)
    flown = fetch_period(flock) * FASTEST / birds
    assert 4 * flown <= steps_ahead(flock, False) * (1 + 1e-9)
