# SPDX-License-Identifier: Apache-2.0
"""The open chunk: messages that are not on disk yet."""

from collections.abc import Sequence

from zstandard import ZstdCompressor

from flock_sim.bag.chunk import MESSAGE, MESSAGE_FIELDS, MESSAGE_OPCODE, SealedChunk, seal


class OpenChunk:
    """Messages by channel. Added messages count from `take` on, so that a group counts as a whole.

    `size` is the uncompressed size of the taken messages, in bytes.
    """

    def __init__(self, topics: Sequence[str]) -> None:
        """Accept messages of `topics`, channels 1, 2, ..."""
        # For each channel, [log time, offset in body, log time, offset in body, ...].
        self._entries: list[tuple[int, list[int]]] = [
            (channel, []) for channel in range(1, len(topics) + 1)
        ]
        self._slots: dict[int | str, tuple[int, list[int]]] = dict(enumerate(self._entries))
        self._slots.update(zip(topics, self._entries, strict=True))
        self._body = bytearray()
        self.size = 0

    def add(
        self, topic: int | str, log_time: int, data: bytes, publish_time: int, sequence: int
    ) -> None:
        """Append a message; `topic` is its name or its index, from 0.

        Raises KeyError for an unknown topic, struct.error for values that a message can't hold.
        """
        channel, entries = self._slots[topic]
        body = self._body
        at = len(body)
        body += MESSAGE.pack(
            MESSAGE_OPCODE, MESSAGE_FIELDS + len(data), channel, sequence, log_time, publish_time
        )
        body += data
        entries += (log_time, at)

    def take(self) -> None:
        """Make all added messages count."""
        self.size = len(self._body)

    def drop_incomplete(self) -> None:
        """Drop messages that were added but, because of an exception such as Ctrl-C, not taken."""
        if len(self._body) == self.size:
            return
        for _, entries in self._entries:
            while entries and entries[-1] >= self.size:
                del entries[-2:]
        del self._body[self.size :]

    def clear(self) -> None:
        """Drop everything."""
        self.size = 0
        for _, entries in self._entries:
            entries.clear()
        self._body.clear()

    def seal(self, offset: int, compressor: ZstdCompressor) -> SealedChunk:
        """Make the chunk, not empty, for byte `offset` of the file."""
        return seal(self._body, self._entries, offset, compressor)
