# SPDX-License-Identifier: Apache-2.0
"""Playing recorded messages in the order of the bag, and being operated meanwhile."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import TypeVar

from flock_tools.play_schedule import Schedule

LOOK_EVERY = 0.05
"""Time, in s, between two looks at what does not come by the inbox: keys and signals."""

Recorded = tuple[str, int, bytes]
"""Topic, log time in ns, serialised data."""

Answer = TypeVar("Answer")


class Playback:
    """Plays the messages of a bag, one after the other, until there are none or it is stopped.

    Only the thread that runs it touches it; others `ask` it.
    """

    def __init__(
        self,
        read: Callable[[int | None], Iterator[Recorded]],
        publish: Callable[[str, bytes], None],
        schedule: Schedule,
        span: tuple[int, int],
        *,
        meet: Callable[[], None] = lambda: None,
        begin: int | None = None,
        loop: bool = False,
    ) -> None:
        """Play what `read` yields from recorded time `begin` on, in ns; None: from the first one.

        `span` are the first and the last recorded time that can be sought. `meet` waits for those
        who listen, before time goes on for the first time. `loop`: begin again at the end.
        """
        self.schedule = schedule
        self.played: Counter[str] = Counter()
        """How many messages were published, by topic."""
        self._read = read
        self._publish = publish
        self._meet = meet
        self._span = span
        self._begin = begin
        self._loop = loop
        self._met = self._stopped = self._over = False
        self._inbox: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._source = read(begin)
        self._upcoming = next(self._source, None)

    @property
    def empty(self) -> bool:
        """Whether nothing is left to play."""
        return self._upcoming is None

    @property
    def reached(self) -> float:
        """The recorded time reached, in s since the first message of the bag."""
        first, last = self._span
        return (min(max(self.schedule.position, first), last) - first) / 1e9

    def run(self, look: Callable[[], None] = lambda: None) -> None:
        """Play; `look` is called now and then, and may operate the playback."""
        try:
            self._run(look)
        finally:
            self._over = True
            while not self._inbox.empty():
                self._serve(0.0)

    def ask(self, operate: Callable[[], Answer]) -> Future[Answer]:
        """Have `operate` called between two messages; from any thread."""
        answer: Future[Answer] = Future()

        def serve() -> None:
            answer.set_result(operate())

        self._inbox.put(serve)
        if self._over:  # nobody else looks there any more
            self._serve(0.0)
        return answer

    def toggle_paused(self) -> None:
        """Pause, or go on."""
        if self.schedule.paused:
            self.schedule.resume()
        else:
            self.schedule.pause()

    def set_rate(self, rate: float) -> bool:
        """Play at another rate; False where it is not above 0 and finite."""
        if not 0.0 < rate < math.inf:
            return False
        self.schedule.set_rate(rate)
        return True

    def seek(self, stamp: int) -> bool:
        """Go on with what was recorded from `stamp`, in ns, on; False where nothing was."""
        first, last = self._span
        if not first <= stamp <= last:
            return False
        self._go_to(stamp)
        return True

    def play_next(self) -> bool:
        """Play one message, in a pause; False where there is no pause or no message."""
        if self._over or not self.schedule.paused:
            return False
        if self._upcoming is None and self._loop:
            self._go_to(self._begin)
        return self._play()

    def stop(self) -> None:
        """End the playback."""
        self._stopped = True

    def _run(self, look: Callable[[], None]) -> None:
        look_at = 0.0
        while not self._stopped:
            if time.monotonic() >= look_at:
                look()
                look_at = time.monotonic() + LOOK_EVERY
            if not self._met and not self.schedule.paused:
                self._go()
                continue
            if self._upcoming is None and not self.schedule.paused:
                if not self._loop:
                    break
                self._go_to(self._begin)
            left = self.schedule.left(self._upcoming[1]) if self._upcoming else math.inf
            if left > 0.0:
                self._serve(min(left, LOOK_EVERY))
            elif not self._inbox.empty():
                self._serve(0.0)
            else:
                self._play()

    def _go(self) -> None:
        """Meet those who listen; recorded time stands still meanwhile."""
        position = self.schedule.position
        self._meet()
        self.schedule.jump(position)
        self._met = True

    def _play(self) -> bool:
        if self._upcoming is None:
            return False
        topic, stamp, data = self._upcoming
        self._publish(topic, data)
        self.played[topic] += 1
        self.schedule.reached(stamp)
        self._upcoming = next(self._source, None)
        return True

    def _go_to(self, stamp: int | None) -> None:
        self._source = self._read(stamp)
        self._upcoming = next(self._source, None)
        self.schedule.jump(self._span[0] if stamp is None else stamp)

    def _serve(self, wait: float) -> None:
        """Do what the next in the inbox asks for, if anything comes within `wait` s."""
        try:
            operate = self._inbox.get(timeout=wait) if wait > 0.0 else self._inbox.get_nowait()
        except Empty:
            return
        operate()
