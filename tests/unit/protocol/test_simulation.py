# SPDX-License-Identifier: Apache-2.0
"""The step protocol under random delivery, loss, duplication, crashes and forged messages.

FLOCK_SIMULATED_STEPS=N flies N steps instead of a few; `make simulate` flies a million.
"""

from __future__ import annotations

import os

import pytest

from simulate import SeedFailed, fly, fly_steps
from support.simulator.random_flight import RandomFlight

STEPS = int(os.environ.get("FLOCK_SIMULATED_STEPS", "3000"))


def test_a_flight_with_all_faults_is_the_reference_and_ends_within_a_bounded_number() -> None:
    toll = fly_steps(STEPS)
    assert toll.steps >= STEPS
    assert min(toll.events.values()) > 0, f"faults that did not happen: {toll}"
    print(toll)


def test_a_seed_flies_the_same_flight_each_time() -> None:
    seeds = range(300, 310)
    first = [fly(seed).digests for seed in seeds]
    assert [fly(seed).digests for seed in seeds] == first
    assert len({digest for (digest,) in first}) == len(seeds)


def test_a_failure_names_the_seed_and_how_to_fly_it_again(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(self: RandomFlight) -> None:
        raise AssertionError("a bit has changed")

    monkeypatch.setattr(RandomFlight, "fly", wrong)
    with pytest.raises(SeedFailed, match=r"seed 17: .* a bit has changed\n.*simulate.py --seed 17"):
        fly_steps(1, first_seed=17)
