# SPDX-License-Identifier: Apache-2.0
"""The digest of what was flown: equal on every machine, whatever the format of the messages."""

from __future__ import annotations

import hashlib

import numpy as np

from flock_sim.physics.arrays import FloatArray, IntArray
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
        values = state.position, state.speed, state.circulation, state.interaction_drag
        self.add_rows(np.array([state.step]), np.array([state.time]), np.array([values]))

    def add_rows(self, step: IntArray, time: FloatArray, values: FloatArray) -> None:
        """Add the next states of the flight, many at once, which is faster.

        `step` and `time` have shape (states,), `values` (states, 4, birds, members): position,
        speed, circulation and interaction drag.
        """
        words = np.empty((len(step), 2 + values[0].size), dtype="<u8")
        words[:, 0] = step
        numbers = words[:, 1:].view("<f8")
        numbers[:, 0] = time
        numbers[:, 1:].reshape(values.shape)[:] = values
        numbers[np.isnan(numbers)] = np.nan
        self._hash.update(words.data)

    def hexdigest(self) -> str:
        """Return the digest of the states so far, 64 hexadecimal digits."""
        return self._hash.hexdigest()
