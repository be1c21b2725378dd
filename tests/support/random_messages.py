# SPDX-License-Identifier: Apache-2.0
"""Hypothesis strategies for every message of Flock's."""

import numpy as np
from hypothesis import strategies as st

from flock_sim.messages import types

REAL = st.floats(allow_nan=True, allow_infinity=True)

FIELDS = {
    "Q": st.integers(0, 2**64 - 1),
    "q": st.integers(-(2**63), 2**63 - 1),
    "I": st.integers(0, 2**32 - 1),
    "i": st.integers(-(2**31), 2**31 - 1),
    "B": st.integers(0, 255),
    "d": REAL,
    "text": st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20),
    "numbers": st.lists(REAL, max_size=50).map(lambda v: np.array(v, dtype=np.float64)),
}
"""Values of fields, by kind."""

MESSAGES = {
    message: st.builds(message, *(FIELDS[kind] for kind in message.KINDS))
    for message in (
        types.Wing,
        types.Stage,
        types.State,
        types.Grant,
        types.Progress,
        types.Memory,
        types.Ages,
        types.Checkpoint,
        types.Push,
        types.Time,
    )
}
"""Messages, by class."""
