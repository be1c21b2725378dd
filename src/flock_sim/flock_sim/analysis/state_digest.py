# SPDX-License-Identifier: Apache-2.0
"""The digest of what was flown: equal on every machine, whatever the format of the messages."""

from __future__ import annotations

import hashlib

import numpy as np

from flock_sim.physics.flock_state import FlockState


class StateDigest:
    """SHA-256 over the values of all recorded states of a flight, in the order of their steps.

    For each state, these are hashed in little-endian order: step as int64, time as float64, and
    position, speed, circulation and interaction drag as float64, each of shape (birds, members).
    All NaN count as one value, and 0.0 and -0.0 as two.
    """

    def __init__(self) -> None:
        """Start before the first state."""
        self._hash = hashlib.sha256()

    def add(self, state: FlockState) -> None:
        """Add the next state of the flight."""
        self._hash.update(np.int64(state.step).astype("<i8").tobytes())
        self._hash.update(np.float64(state.time).astype("<f8").tobytes())
        for values in (
            state.position,
            state.speed,
            state.circulation,
            state.interaction_drag,
        ):
            self._hash.update(np.where(np.isnan(values), np.nan, values).astype("<f8").tobytes())

    def hexdigest(self) -> str:
        """Return the digest of the states so far, 64 hexadecimal digits."""
        return self._hash.hexdigest()
