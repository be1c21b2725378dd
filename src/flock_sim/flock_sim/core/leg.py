# SPDX-License-Identifier: Apache-2.0
"""A leg: the stages up to the next step at which a bird has more to do than to exchange them.

Nearly all of a flight is legs. What a bird is on one is a row of words that compiled code goes on
with (`nodes/exchange.py`), without any Python between a message and the next. The protocol embarks
on a leg, and lands from it wherever it is; in between it knows nothing of what is flown.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

import numpy as np

from flock_sim.core.kernel import FloatArray, IntArray
from flock_sim.core.stage_message import stage_bytes

# The words: where the leg is and where it ends, in ticks, and what is in all of its messages.
TICK, END, RUN_ID, EPOCH, BIRD, MEMBERS, NEIGHBOURS, SIZE = range(8)
# How many messages of other runs came on the way; the tick when somebody last went on.
FOREIGN, BEFORE = 8, 9
# The addresses of the arrays that `feel_and_move` is given.
OWN, GEOMETRY, HEARD, MINE, WORK = range(10, 15)
# Those of what messages are sent by, and taken into; and of the stage messages of the bird itself,
# of even ticks and of odd ones.
PUBLISHER, INCOMING, OUTGOING = 15, 16, 17
# The header of the message that is looked at: four words.
HEADER = 19
# For each neighbour: its number, the address of what its messages are taken by, and whether those
# of even and of odd ticks are here.
FIRST = 23
NAME, SUBSCRIPTION, HERE = range(3)
EACH = 4

Lacking = tuple[AbstractSet[int], AbstractSet[int]]
"""The neighbours whose messages are not here: of even ticks, and of odd ones."""


class Leg:
    """The words of one bird's legs. They are of one bird, and of one leg after the other."""

    def __init__(
        self, bird: int, neighbours: Sequence[int], members: int, arrays: Sequence[FloatArray]
    ) -> None:
        """Be of `bird`; `arrays`, OWN to WORK, stay where they are, and are kept."""
        self.words: IntArray = np.zeros(FIRST + EACH * len(neighbours), np.int64)
        self._arrays = arrays
        self._word = self.words.data  # a word of it costs less than one of an array
        self._places = {other: FIRST + EACH * k for k, other in enumerate(neighbours)}
        size = len(stage_bytes(arrays[MINE - OWN][0], members))
        self.words[BIRD : SIZE + 1] = bird, members, len(neighbours), size
        for address, array in enumerate(arrays, start=OWN):
            if not array.flags.c_contiguous:
                raise ValueError(f"array {address - OWN} of a leg is not contiguous")
            self.words[address] = array.ctypes.data
        for other, place in self._places.items():
            self.words[place + NAME] = other

    def connect(
        self, publisher: int, incoming: int, outgoing: Sequence[int], inlets: Sequence[int]
    ) -> None:
        """Take note of the addresses from PUBLISHER on, and of the neighbours' `inlets`."""
        self.words[PUBLISHER:HEADER] = publisher, incoming, *outgoing
        for place, inlet in zip(self._places.values(), inlets, strict=True):
            self.words[place + SUBSCRIPTION] = inlet

    def begin(self, tick: int, end: int, run_id: int, epoch: int, lacking: Lacking) -> None:
        """Be at `tick`, its message sent, with those of the neighbours that are not `lacking`."""
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
        """Whether the end is reached: the values of that tick are known, and not sent yet."""
        return bool(self._word[TICK] >= self._word[END])

    @property
    def moved(self) -> bool:
        """Whether a stage was flown when somebody last went on."""
        return bool(self._word[TICK] > self._word[BEFORE])

    @property
    def foreign(self) -> int:
        """How many messages of other runs were left out."""
        return int(self._word[FOREIGN])

    @property
    def lacking(self) -> Lacking:
        """The neighbours whose messages are not here."""
        even, odd = (
            {other for other, place in self._places.items() if not self._word[place + HERE + side]}
            for side in range(2)
        )
        return even, odd
