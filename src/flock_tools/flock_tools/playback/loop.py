# SPDX-License-Identifier: Apache-2.0
"""Plays recorded messages, one after the other, and handles requests meanwhile."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from queue import Empty, Queue
from typing import TypeVar

from flock_sim.bag.reading.reader import Recorded
from flock_sim.console.arguments import LONGEST as FASTEST
from flock_tools.playback.schedule import Schedule

LOOK_EVERY = 0.05
"""Interval between polls of keys and signals, which do not use the inbox, in s."""

LONG = 60.0
"""Shortest wait for a message that is reported to the user, in s."""

Answer = TypeVar("Answer")


class NotPublishable(ValueError):
    """A recorded message that can't be published with the type of its topic."""


class Playback:
    """Plays the messages of a bag, one after the other, until the end or a stop.

    Only the thread that runs it may access it. Other threads use `ask`.
    """

    def __init__(
        self,
        read: Callable[[int | None], Iterator[Recorded]],
        publish: Callable[[str, bytes], None],
        schedule: Schedule,
        span: tuple[int, int],
        *,
        before: Callable[[int], Sequence[Recorded]] = lambda at: (),
        meet: Callable[[], None] = lambda: None,
        waits: Callable[[float, int], None] = lambda left, stamp: None,
        leaves_out: Callable[[str, str], None] = lambda topic, reason: None,
        tick: Callable[[int], None] = lambda at: None,
        tick_every: float | None = None,
        begin: int | None = None,
        loop: bool = False,
        delay: float = 0.0,
    ) -> None:
        """Play the messages that `read` yields from recorded time `begin`, in ns; None: all.

        `span` has the first and the last recorded time of a seek. If the playback starts at a
        recorded time or seeks to it, the messages that `before` returns for it are published first.
        `publish` raises NotPublishable. `meet` waits for listeners before time starts to run.
        `waits` is called once for a message that is due in more than `LONG` s. `leaves_out` is
        called for the first message of a topic that can't be published, with the reason. `tick`
        is called with the recorded time every `tick_every` s, in pauses too; None: never. With
        `loop`, the playback starts again at the end. It waits `delay` s at each start.
        """
        self.schedule = schedule
        self.played: Counter[str] = Counter()
        """Number of published messages by topic."""
        self.left_out: Counter[str] = Counter()
        """Number of messages that could not be published, by topic."""
        self._read = read
        self._publish = publish
        self._before = before
        self._meet = meet
        self._waits = waits
        self._leaves_out = leaves_out
        self._span = span
        self._tick = tick
        self._tick_every = tick_every
        self._begin = begin
        self._loop = loop
        self._delay = delay
        self._met = self._stopped = self._over = False
        # Not SimpleQueue: a signal near the end of its wait makes it wait for ever (Python 3.11).
        self._inbox: Queue[Callable[[], None]] = Queue()
        self._announced: int | None = None
        self._source = read(begin)
        self._advance()
        self._first: Sequence[Recorded] = () if begin is None else before(begin)

    @property
    def empty(self) -> bool:
        """Whether no message is left to play."""
        return self._upcoming is None

    @property
    def reached(self) -> float:
        """The recorded time reached, in s since the first message of the bag."""
        first, last = self._span
        return (min(max(self.schedule.position, first), last) - first) / 1e9

    def run(self, look: Callable[[], None] = lambda: None) -> None:
        """Play. `look` is called every LOOK_EVERY s or later, and may control the playback."""
        try:
            self._run(look)
        finally:
            self._over = True
            while not self._inbox.empty():
                self._serve(0.0)

    def ask(self, operate: Callable[[], Answer]) -> Future[Answer]:
        """Have `operate` called between two messages. Any thread may call this."""
        answer: Future[Answer] = Future()

        def serve() -> None:
            answer.set_result(operate())

        self._inbox.put(serve)
        if self._over:  # the playback thread does not read the inbox any more
            self._serve(0.0)
        return answer

    def toggle_paused(self) -> None:
        """Pause or resume."""
        if self.schedule.paused:
            self.schedule.resume()
        else:
            self.schedule.pause()

    def set_rate(self, rate: float) -> bool:
        """Play at another rate. Return False if it is not above 0, at most `FASTEST`."""
        if not 0.0 < rate <= FASTEST:
            return False
        self.schedule.set_rate(rate)
        return True

    def seek(self, stamp: int) -> bool:
        """Continue at recorded time `stamp`, in ns. Return False if it is outside the bag."""
        first, last = self._span
        if not first <= stamp <= last:
            return False
        self._go_to(stamp)
        return True

    def play_next(self) -> bool:
        """Play one message in a pause. Return False without a pause or without a message."""
        if self._over or not self.schedule.paused:
            return False
        if self._upcoming is None and self._loop:
            self._go_to(self._begin)
        return self._play()

    def stop(self) -> None:
        """End the playback."""
        self._stopped = True

    def _run(self, look: Callable[[], None]) -> None:
        look_at = time.monotonic()
        tick_at = math.inf if self._tick_every is None else look_at
        while not self._stopped:
            if (now := time.monotonic()) >= look_at:
                look()
                look_at = time.monotonic() + LOOK_EVERY
            if self._tick_every is not None and now >= tick_at:
                self._tick(self.schedule.position)
                tick_at = max(tick_at + self._tick_every, now)  # missed ticks are left out
            if not self._met and not self.schedule.paused:
                self._go()
                continue
            if self._upcoming is None and not self.schedule.paused:
                if not self._loop:
                    break
                self._go_to(self._begin, self._delay)
            if self._first and self.schedule.running:
                self._say_first()
                continue
            left = self.schedule.left(self._upcoming[1]) if self._upcoming else math.inf
            if left > 0.0:
                self._announce(left)
                self._serve(min(left, LOOK_EVERY, tick_at - now))
            elif not self._inbox.empty():
                self._serve(0.0)
            else:
                self._play()

    def _go(self) -> None:
        """Wait for listeners. Recorded time stands still meanwhile."""
        position = self.schedule.position
        self._meet()
        self.schedule.jump(position, self._delay)
        self._met = True

    def _play(self) -> bool:
        if self._upcoming is None:
            return False
        self._say_first()
        topic, stamp, data = self._upcoming
        self._say(topic, data)
        self.schedule.reached(stamp)
        self._advance()
        return True

    def _advance(self) -> None:
        """Read the next message."""
        self._upcoming: Recorded | None = next(self._source, None)
        self.schedule.upcoming = self._upcoming[1] if self._upcoming else self._span[1]

    def _say_first(self) -> None:
        """Publish the latched messages from before the start or seek time."""
        first, self._first = self._first, ()
        for topic, _, data in first:
            self._say(topic, data)

    def _say(self, topic: str, data: bytes) -> None:
        try:
            self._publish(topic, data)
        except NotPublishable as error:
            self.left_out[topic] += 1
            if self.left_out[topic] == 1:
                self._leaves_out(topic, str(error))
        else:
            self.played[topic] += 1

    def _announce(self, left: float) -> None:
        """Report a long wait once, unless it is a pause."""
        if LONG < left < math.inf and self._upcoming and self._upcoming[1] != self._announced:
            self._announced = self._upcoming[1]
            self._waits(left, self._upcoming[1])

    def _go_to(self, stamp: int | None, delay: float = 0.0) -> None:
        self._source = self._read(stamp)
        self._advance()
        self._first = () if stamp is None else self._before(stamp)
        self.schedule.jump(self._span[0] if stamp is None else stamp, delay)

    def _serve(self, wait: float) -> None:
        """Handle the next request in the inbox, if one is received within `wait` s."""
        try:
            operate = self._inbox.get(timeout=wait) if wait > 0.0 else self._inbox.get_nowait()
        except Empty:
            return
        operate()
