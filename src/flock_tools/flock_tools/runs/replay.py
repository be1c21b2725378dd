# SPDX-License-Identifier: Apache-2.0
"""Plays a bag: selects its messages by the options, publishes them, and returns a summary."""

from __future__ import annotations

import gc
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from threading import Thread
from typing import Any

import rclpy
from rclpy.context import Context

from flock_sim.bag.reading.reader import BagReader, Recorded
from flock_sim.console.arguments import not_negative_number, note, positive_number
from flock_sim.console.progress import playback_bar
from flock_sim.console.signals import Stop
from flock_sim.console.stdout import results_only_on_stdout
from flock_sim.errors import FlockError
from flock_sim.messages.topics import CLOCK_TOPIC
from flock_sim.recording.own_parts import BIRD, recorded_parts
from flock_sim.ros.fastdds_shutdown import leave
from flock_sim.ros.log import ros_context
from flock_sim.ros.process import executing
from flock_sim.ros.settings_check import check_settings
from flock_tools.playback.keyboard import DOWN, QUIT, RIGHT, SPACE, UP, keyboard
from flock_tools.playback.loop import Playback
from flock_tools.playback.player import Player
from flock_tools.playback.schedule import BILLION, Schedule
from flock_tools.playback.topics import Selection, Wishes, select

KEYS = "space: pause or continue   right: next message   up, down: rate   q: end"

LONGEST = 2**64 / BILLION
"""The longest recorded time, in s, that a bag can hold."""

STORAGES = ("mcap", "sqlite3")
"""What rosbag2's player takes after -s, which is the start here."""

SOON = BILLION
"""Recorded time, in ns, within which a next message makes the latched one unnecessary."""

FASTER = 1.1
"""Factor of the rate per press of the up arrow."""


def play(
    bag: BagReader, options: Namespace, rate: float, stop: Stop, ros_arguments: Sequence[str] = ()
) -> dict[str, Any]:
    """Play `bag` by `options` until its end or `stop`. Return a summary.

    Raises FlockError if an option is invalid, or if the options select no message.
    """
    extract = _extract(bag, options)
    delay = not_negative_number("--delay", options.delay)
    clock = None if options.clock is None else positive_number("--clock", options.clock)
    reserved = {} if clock is None else {CLOCK_TOPIC: "the player publishes its own (--clock)"}
    wishes = Wishes(options.topics, options.exclude_topics or (), options.remap or (), reserved)
    selection = select(bag, wishes)
    for name, reason in selection.skipped.items():
        some = "some of " if name in selection.topics else ""
        note(f"note: {some}{name} is left out: {reason}")
    for line in selection.notes:
        note(f"note: {line}")
    span, start = (extract.first, extract.last), extract.start
    schedule = Schedule(span[0] + start, rate, paused=options.paused)
    own_birds = [part.name for part in recorded_parts(bag.records) if part.kind == BIRD]
    with (
        results_only_on_stdout(),
        _player(selection, own_birds, clock, ros_arguments) as (player, spin),
    ):
        playback = Playback(
            lambda at: selection.renamed(bag.by_time(selection.streams, at, extract.end)),
            player.say_when_heard if rate == 0.0 else player.say,
            schedule,
            span,
            before=lambda at: list(selection.renamed(latched_before(bag, selection, at))),
            meet=lambda: player.meet(stop),
            waits=lambda left, stamp: note(_long_wait(left, stamp - span[0])),
            leaves_out=lambda name, reason: note(
                f"note: messages of {name} are left out: {reason}"
            ),
            tick=player.tick,
            tick_every=1.0 / clock if clock else None,
            begin=span[0] + start if start else None,
            loop=options.loop,
            delay=delay,
        )
        if playback.empty:
            raise FlockError(
                f"{bag.path}: these topics have no message from {start / BILLION:.12g} s on, within"
                " --duration: choose other topics, or another --start or --duration"
            )
        player.serve(playback)
        spin()
        gc.freeze()  # avoids garbage collections of milliseconds over existing objects
        try:
            schedule.jump(span[0] + start)
            _run(playback, span, stop, keys=not options.disable_keyboard_controls)
            player.wait_until_heard(stop)
        finally:
            gc.unfreeze()
    return {
        "run": str(options.run),
        "messages": playback.played.total(),
        "topics": {name: playback.played[name] for name in selection.topics},
        "skipped": dict(selection.skipped),
        "left_out": dict(playback.left_out),
        "rate": schedule.rate,
        "reached": playback.reached,
    }


@dataclass(frozen=True)
class Extract:
    """The part of a bag that is played, in ns of recorded time."""

    first: int
    last: int
    start: int
    """Start of the playback, relative to `first`."""
    end: int | None
    """Time from which messages are not played; None: all are played."""


def _extract(bag: BagReader, options: Namespace) -> Extract:
    """Return the part that `options` select. Raises FlockError if it is empty."""
    first, last = bag.first_time, bag.last_time
    if first is None or last is None:
        raise FlockError(f"{bag.path}: it has no messages; name another bag")
    start = recorded_time("--start", options.start)
    if start > last - first:
        raise FlockError(
            f"--start {options.start}: must be {(last - first) / BILLION:.12g} or less, the"
            " recorded time in s"
        )
    if options.duration is None:
        return Extract(first, last, start, None)
    end = first + start + recorded_time("--duration", options.duration, above=True) + 1
    return Extract(first, min(last, end - 1), start, end)


def recorded_time(name: str, text: str, *, above: bool = False) -> int:
    """Return `text`, a number of seconds from 0, or `above` it, in ns, converted as a decimal.

    Raises FlockError if it is invalid.
    """
    try:
        value = Decimal(text)
        if not 0 <= value <= LONGEST or (above and not value):
            raise InvalidOperation
    except InvalidOperation:
        least = "finite number above 0, at most" if above else "number from 0 to"
        storage = "; leave out -s, since a file tells its format" if text in STORAGES else ""
        raise FlockError(f"{name} {text}: must be a {least} {LONGEST:g}{storage}") from None
    return round(value * BILLION)


def latched_before(bag: BagReader, selection: Selection, at: int) -> list[Recorded]:
    """Return the messages that a late joiner at recorded time `at` would have received at once.

    These are the last messages of each publisher on latched topics. Topics with a message within
    the next `SOON` ns are left out.
    """
    latched = {
        stream: topic.publishers
        for topic in selection.topics.values()
        if topic.latched
        for stream in topic.streams
    }
    if not latched:
        return []
    soon = bag.by_time(latched, at, at + SOON)
    going_on = {selection.played_as(topic) for topic, *_ in soon}
    wanted = {
        stream: many
        for stream, many in latched.items()
        if selection.played_as(stream.topic) not in going_on
    }
    return bag.latest(wanted, at)


def _long_wait(left: float, since: int) -> str:
    return (
        f"note: the next message follows in {left:.0f} s: to skip the pause, begin with --start"
        f" {Decimal(since) / BILLION}, or press space, the right arrow and space, or call ~/seek"
    )


@contextmanager
def _player(
    selection: Selection,
    own_birds: Sequence[str],
    clock: float | None,
    ros_arguments: Sequence[str],
) -> Iterator[tuple[Player, Callable[[], None]]]:
    """Give the node, and a function that starts to serve its services in another thread."""
    context: Context = ros_context(ros_arguments)
    try:
        with executing("single", context) as executor:
            player = Player(selection.topics, context, own_birds, clock=clock is not None)
            executor.add_node(player)
            check_settings(context.get_domain_id())
            thread = Thread(target=executor.spin, daemon=True)
            try:
                yield player, thread.start
            finally:
                executor.shutdown()
                if thread.ident is not None:
                    thread.join()
                leave(context, [player])  # the executor, after its shutdown, does not hold the node
    finally:
        rclpy.try_shutdown(context=context)


def _run(playback: Playback, span: tuple[int, int], stop: Stop, *, keys: bool) -> None:
    """Play, and react to signals and, with `keys`, to keys meanwhile."""
    schedule = playback.schedule
    length = (span[1] - span[0]) / BILLION
    with keyboard(lambda: note(KEYS), keys) as pressed, playback_bar(length) as show:

        def look() -> None:
            for key in pressed():
                if key == SPACE:
                    playback.toggle_paused()
                elif key == RIGHT:
                    playback.play_next()
                elif key in (UP, DOWN):
                    playback.set_rate(schedule.rate * (FASTER if key == UP else 1.0 / FASTER))
                elif key == QUIT:
                    playback.stop()
            if stop:
                playback.stop()
            show(playback.reached, schedule.rate, schedule.paused)

        playback.run(look)
