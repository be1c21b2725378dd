# SPDX-License-Identifier: Apache-2.0
"""The chunk in the making: messages that are not on disk yet."""

from collections.abc import Sequence

from zstandard import ZstdCompressor

from flock_sim.bag.chunk import MESSAGE, MESSAGE_FIELDS, MESSAGE_OPCODE, SealedChunk, seal


class OpenChunk:
    """Messages by channel; what is added counts once it is taken, so that a group counts as one.

    `size` is of the messages taken, in bytes, uncompressed.
    """

    def __init__(self, topics: Sequence[str]) -> None:
        """Be open to messages of `topics`, channels 1, 2, ..."""
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
        """Put a message at the end; `topic` is its name or its place, from 0.

        Raises KeyError for an unknown topic, struct.error for what a message can't hold.
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
        """Let count what was added."""
        self.size = len(self._body)

    def drop_incomplete(self) -> None:
        """Drop what was added and, since an exception came (Ctrl-C, say), not taken."""
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
