# SPDX-License-Identifier: Apache-2.0
"""The processes of a simulated flight, and the messages in flight between them."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from random import Random
from typing import Any


@dataclass(eq=False)
class Process:
    """One incarnation of a bird, the clock or the recorder; or a forger, which has no `core`."""

    who: str
    life: int
    core: Any
    hears: dict[str, Callable[[bytes], None]] = field(default_factory=dict)
    latched: dict[str, deque[bytes]] = field(default_factory=dict)


@dataclass(eq=False)
class Queue:
    """The messages in flight from one process to another on one topic."""

    sender: Process
    to: Process
    topic: str
    depth: int
    place: int
    """Its index in the list of queues."""
    messages: list[bytes] = field(default_factory=list)

    @property
    def key(self) -> tuple[int, int, str]:
        return self.sender.life, self.to.life, self.topic


class Wires:
    """All queues that are not empty. Every choice is one of `random`, so a seed repeats them."""

    def __init__(self, random: Random) -> None:
        self.ordered = random.random() < 0.7
        """Whether the messages of one publisher on one topic keep their order, as in DDS."""
        self.deliveries = 0
        self.lost = 0
        """Number of stages that were lost."""
        self._random = random
        self.queues: list[Queue] = []
        self._by_key: dict[tuple[int, int, str], Queue] = {}
        self._trace = hashlib.blake2b(digest_size=16)

    @property
    def digest(self) -> str:
        """A digest of all events so far: deliveries, births and deaths, in their order."""
        return self._trace.hexdigest()

    @property
    def in_flight(self) -> int:
        """Number of messages in flight."""
        return sum(len(queue.messages) for queue in self.queues)

    def note(self, *event: object) -> None:
        """Add an event to the digest."""
        self._trace.update(repr(event).encode())

    def post(self, sender: Process, to: Process, topic: str, data: bytes, depth: int) -> bytes:
        """Queue a message. A full queue may lose its oldest one; return that, or b""."""
        key = sender.life, to.life, topic
        queue = self._by_key.get(key)
        if queue is None:
            queue = self._by_key[key] = Queue(sender, to, topic, depth, len(self.queues))
            self.queues.append(queue)
        queue.messages.append(data)
        full = len(queue.messages) > depth
        return queue.messages.pop(0) if full and self._random.random() < 0.5 else b""

    def choose(self, takes: Callable[[Queue], bool]) -> Queue | None:
        """Return a random queue that its receiver `takes` a message from; None without one."""
        for _ in range(4):  # most queues are taken from, so the list of all is seldom needed
            if self.queues:
                queue = self.queues[int(self._random.random() * len(self.queues))]
                if takes(queue):
                    return queue
        able = [queue for queue in self.queues if takes(queue)]
        return self._random.choice(able) if able else None

    def deliver(self, queue: Queue, *, copy: bool = False) -> None:
        """Deliver the next message of a queue (any message if not `ordered`), or a copy."""
        at = 0 if self.ordered else int(self._random.random() * len(queue.messages))
        data = queue.messages[at]
        if not copy:
            self._remove(queue, at)
        self.deliveries += 1
        self._trace.update(b"%d %d %b" % (queue.sender.life, queue.to.life, data))
        queue.to.hears[queue.topic](data)

    def lose_stage(self) -> None:
        """Lose a stage in flight, if there is one."""
        queues = [queue for queue in self.queues if queue.topic.endswith("/stage")]
        if queues:
            queue = self._random.choice(queues)
            self._remove(queue, self._random.randrange(len(queue.messages)))
            self.lost += 1

    def cut(self, gone: Process) -> None:
        """Drop the messages to a dead process, and a random number of the last ones from it."""
        for queue in list(self.queues):
            if queue.sender is gone:
                del queue.messages[self._random.randint(0, len(queue.messages)) :]
            if queue.to is gone or not queue.messages:
                self.drop([queue])

    def drop(self, queues: Iterable[Queue]) -> None:
        """Drop queues with all their messages."""
        for queue in list(queues):
            del self._by_key[queue.key]
            last = self.queues.pop()
            if last is not queue:
                self.queues[queue.place], last.place = last, queue.place

    def _remove(self, queue: Queue, at: int) -> None:
        del queue.messages[at]
        if not queue.messages:
            self.drop([queue])
