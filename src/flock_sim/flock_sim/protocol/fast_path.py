# SPDX-License-Identifier: Apache-2.0
"""The fast path: the stages up to the next step at which a bird does more than exchange them.

Nearly all of a flight is on it. There the bird is a row of words, which compiled code
(`ros/compiled_exchange.py`) advances without any Python between two messages. The protocol enters
the fast path and leaves it. In between the protocol does not know the state of the bird.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

import numpy as np

from flock_sim.messages.stage_layout import stage_bytes
from flock_sim.physics.arrays import FloatArray, IntArray

# The words: the current tick, the end tick, and the constant fields of the bird's messages.
TICK, END, RUN_ID, EPOCH, BIRD, MEMBERS, NEIGHBOURS, SIZE = range(8)
# Number of messages of other runs since the entry; tick at the begin of the last `exchange`.
FOREIGN, BEFORE = 8, 9
# The addresses of the array arguments of `feel_and_move`.
OWN, GEOMETRY, HEARD, MINE, WORK = range(10, 15)
# The addresses of the publisher, of the buffer for incoming messages, and of the bird's own stage
# messages: of even ticks and of odd ticks.
PUBLISHER, INCOMING, OUTGOING = 15, 16, 17
# The header of the message being checked: four words.
HEADER = 19
# For each neighbour: its number, the address of the subscription to it, and whether its messages
# of the even tick and of the odd tick have arrived.
FIRST = 23
NAME, SUBSCRIPTION, HERE = range(3)
EACH = 4

Lacking = tuple[AbstractSet[int], AbstractSet[int]]
"""The neighbours whose messages have not arrived: of the even tick, and of the odd tick."""


class FastPath:
    """The words of one bird's exchange. They are reused for each part of the flight."""

    def __init__(
        self, bird: int, neighbours: Sequence[int], members: int, arrays: Sequence[FloatArray]
    ) -> None:
        """Make the words of `bird`; keep `arrays`, OWN to WORK, which must not move in memory."""
        self.words: IntArray = np.zeros(FIRST + EACH * len(neighbours), np.int64)
        self._arrays = arrays
        self._word = self.words.data  # its items are faster to read than those of an array
        self._places = {other: FIRST + EACH * k for k, other in enumerate(neighbours)}
        size = len(stage_bytes(arrays[MINE - OWN][0], members))
        self.words[BIRD : SIZE + 1] = bird, members, len(neighbours), size
        for address, array in enumerate(arrays, start=OWN):
            if not array.flags.c_contiguous:
                raise ValueError(f"array {address - OWN} of a fast path is not contiguous")
            self.words[address] = array.ctypes.data
        for other, place in self._places.items():
            self.words[place + NAME] = other

    def connect(
        self, publisher: int, incoming: int, outgoing: Sequence[int], inlets: Sequence[int]
    ) -> None:
        """Store the addresses from PUBLISHER on, and those of the neighbours' `inlets`."""
        self.words[PUBLISHER:HEADER] = publisher, incoming, *outgoing
        for place, inlet in zip(self._places.values(), inlets, strict=True):
            self.words[place + SUBSCRIPTION] = inlet

    def begin(self, tick: int, end: int, run_id: int, epoch: int, lacking: Lacking) -> None:
        """Start at `tick`: its message is sent, and all messages but the `lacking` are here."""
        word = self._word
        word[TICK], word[END], word[EPOCH], word[FOREIGN] = tick, end, epoch, 0
        word[RUN_ID] = run_id - (run_id >> 63 << 64)  # the same bits, with a sign
        even, odd = lacking
        for other, place in self._places.items():
            word[place + HERE] = other not in even
            word[place + HERE + 1] = other not in odd

    @property
    def tick(self) -> int:
        """The tick whose messages are awaited."""
        return int(self._word[TICK])

    @property
    def over(self) -> bool:
        """Whether the end is reached: the values of that tick are known, but not sent yet."""
        return bool(self._word[TICK] >= self._word[END])

    @property
    def moved(self) -> bool:
        """Whether the last call of `exchange` flew a stage."""
        return bool(self._word[TICK] > self._word[BEFORE])

    @property
    def foreign(self) -> int:
        """Number of messages of other runs, which were ignored."""
        return int(self._word[FOREIGN])

    @property
    def lacking(self) -> Lacking:
        """The neighbours whose messages have not arrived."""
        even, odd = (
            {other for other, place in self._places.items() if not self._word[place + HERE + side]}
            for side in range(2)
        )
        return even, odd
