# SPDX-License-Identifier: Apache-2.0
"""The digest of a flight is SHA-256 over the values of its states, as its definition says."""

import hashlib
import struct

import numpy as np

from flock_sim.analysis.state_digest import StateDigest
from flock_sim.physics.flock_state import FlockState

STATES = [
    FlockState(step, 0.25 * step, *np.random.default_rng(step).standard_normal((6, 3, 2)))
    for step in (0, 5, 10)
]


def defined(states: list[FlockState]) -> str:
    """Compute the digest number by number."""
    digest = hashlib.sha256()
    for state in states:
        digest.update(struct.pack("<qd", state.step, state.time))
        for values in (state.position, state.speed, state.circulation, state.interaction_drag):
            for value in values.ravel().tolist():
                digest.update(struct.pack("<d", value))
    return digest.hexdigest()


def digest(states: list[FlockState]) -> str:
    found = StateDigest()
    for state in states:
        found.add(state)
    return found.hexdigest()


def test_the_digest_is_that_of_all_numbers_in_order() -> None:
    assert digest(STATES) == defined(STATES)
    assert digest([]) == hashlib.sha256().hexdigest()
    assert len({digest(STATES), digest(STATES[::-1]), digest(STATES[:2])}) == 3


def test_states_added_at_once_have_the_same_digest() -> None:
    found = StateDigest()
    found.add(STATES[0])
    found.add_rows(
        np.array([state.step for state in STATES[1:]]),
        np.array([state.time for state in STATES[1:]]),
        np.array([[s.position, s.speed, s.circulation, s.interaction_drag] for s in STATES[1:]]),
    )
    assert found.hexdigest() == defined(STATES)


def test_the_bits_of_nan_do_not_count_and_the_sign_of_zero_does() -> None:
    def with_value(bits: int) -> str:
        speed = np.array([[1.0], [np.uint64(bits).view(np.float64)]])
        return digest([FlockState(0, 0.0, *3 * [np.ones((2, 1))], speed, *2 * [np.ones((2, 1))])])

    quiet, negative, payload = 0x7FF8 << 48, 0xFFF8 << 48, 0x7FF8 << 48 | 5
    assert with_value(negative) == with_value(payload) == with_value(quiet)
    assert with_value(0) != with_value(1 << 63)
