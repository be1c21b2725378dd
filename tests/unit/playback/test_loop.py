# SPDX-License-Identifier: Apache-2.0
"""Recorded messages are played on time, despite delays, and a playback can be controlled."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from concurrent.futures import Future
from threading import Thread, Timer

import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from flock_sim.bag.topic import Topic
from flock_tools.playback import loop as playback
from flock_tools.playback.loop import Playback, Recorded
from flock_tools.playback.schedule import Schedule
from flock_tools.playback.topics import DEFAULT_DEPTH, merged, recorded_profiles

SECOND = 10**9
ORIGIN = 7 * SECOND


class FakeClock:
    """A clock that goes where it is put."""

    def __init__(self) -> None:
        self.time = 1000.0

    def __call__(self) -> float:
        return self.time


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_what_is_due_does_not_depend_on_when_it_is_asked_for(rate: float) -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, rate, now=clock)
    for seconds in range(1, 100):
        clock.time += 0.017 * seconds  # delays of all sizes
        due = clock.time + schedule.left(ORIGIN + seconds * SECOND)
        assert due == pytest.approx(1000.0 + seconds / rate, abs=1e-9)


def test_a_pause_is_no_time() -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, 2.0, now=clock)
    clock.time += 1.0
    schedule.pause()
    assert schedule.left(ORIGIN) == math.inf
    clock.time += 50.0
    assert schedule.position == ORIGIN + 2 * SECOND
    schedule.resume()
    assert schedule.left(ORIGIN + 4 * SECOND) == pytest.approx(1.0)


def test_a_new_rate_counts_from_now_on() -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, 1.0, now=clock)
    clock.time += 3.0
    schedule.set_rate(10.0)
    assert schedule.left(ORIGIN + 4 * SECOND) == pytest.approx(0.1)


def test_at_rate_0_all_is_due_and_a_rate_then_goes_on_from_what_was_played() -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, 0.0, now=clock)
    assert schedule.left(ORIGIN + 1000 * SECOND) == 0.0
    schedule.reached(ORIGIN + 5 * SECOND)
    schedule.set_rate(1.0)
    assert schedule.left(ORIGIN + 6 * SECOND) == pytest.approx(1.0)


def test_a_rate_that_was_too_high_is_not_caught_up_with_at_a_lower_one() -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, 1000.0, now=clock)
    schedule.upcoming = ORIGIN + 5 * SECOND
    clock.time += 60.0  # the schedule is at 60000 s, but the message of 5 s is not played yet
    assert schedule.left(schedule.upcoming) < 0.0
    assert schedule.position == ORIGIN + 5 * SECOND
    schedule.set_rate(1.0)
    assert schedule.left(ORIGIN + 5 * SECOND) == 0.0
    assert schedule.left(ORIGIN + 68 * SECOND) == pytest.approx(63.0)


def test_a_pause_does_not_leave_messages_that_are_due_to_be_caught_up_with() -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, 1000.0, now=clock)
    schedule.upcoming = ORIGIN + 5 * SECOND
    clock.time += 60.0
    schedule.pause()
    schedule.set_rate(1.0)
    schedule.resume()
    assert schedule.left(ORIGIN + 6 * SECOND) == pytest.approx(1.0)


@pytest.mark.parametrize("rate", [0.0, 2.0])
def test_recorded_time_stands_still_in_a_delay(rate: float) -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, rate, now=clock)
    schedule.jump(ORIGIN, 10.0)
    clock.time += 4.0
    assert (schedule.running, schedule.position) == (False, ORIGIN)
    assert schedule.left(ORIGIN) == pytest.approx(6.0)
    schedule.set_rate(1.0)
    assert schedule.left(ORIGIN + SECOND) == pytest.approx(7.0)
    clock.time += 7.0
    assert (schedule.running, schedule.position) == (True, ORIGIN + SECOND)


class Stage:
    """A playback of ten messages, a second apart, that keeps what it publishes."""

    def __init__(self, *, rate: float = 0.0, paused: bool = False, loop: bool = False) -> None:
        self.heard: list[int] = []
        self.met: list[int] = []
        schedule = Schedule(ORIGIN, rate, paused=paused)
        span = (ORIGIN, ORIGIN + 9 * SECOND)
        self.playback = Playback(self.read, self.publish, schedule, span, meet=self.meet, loop=loop)

    def meet(self) -> None:
        self.met.append(len(self.heard))

    def read(self, at: int | None) -> Iterator[Recorded]:
        for k in range(10):
            stamp = ORIGIN + k * SECOND
            if at is None or stamp >= at:
                yield "/topic", stamp, bytes([k])

    def publish(self, topic: str, data: bytes) -> None:
        self.heard.append(data[0])
        if len(self.heard) == 25:
            self.playback.stop()


def test_all_is_played_in_order() -> None:
    stage = Stage()
    stage.playback.run()
    assert stage.heard == list(range(10))
    assert stage.playback.played == {"/topic": 10}
    assert stage.playback.reached == 9.0


def test_a_loop_begins_again_until_it_is_stopped() -> None:
    stage = Stage(loop=True)
    stage.playback.run()
    assert stage.heard == [*range(10), *range(10), *range(5)]


@pytest.mark.parametrize("paused", [False, True])
def test_who_listens_is_met_once_before_time_goes_on(paused: bool) -> None:
    stage = Stage(paused=paused, loop=True)
    play = stage.playback
    if paused:
        play.ask(play.play_next)
        play.ask(play.schedule.resume)
    play.run()
    assert stage.met == [1 if paused else 0]
    assert stage.heard == [*range(10), *range(10), *range(5)]


def test_recorded_time_stands_still_while_who_listens_is_met() -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, 1.0, now=clock)

    def meet() -> None:
        clock.time += 100.0

    def publish(topic: str, data: bytes) -> None:
        assert schedule.position == ORIGIN
        play.stop()

    messages = [("/topic", ORIGIN, b"")]
    play = Playback(lambda _: iter(messages), publish, schedule, (ORIGIN, ORIGIN), meet=meet)
    play.run()
    assert play.played.total() == 1


def test_signals_at_any_moment_of_a_wait_do_not_stop_the_looks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(playback, "LOOK_EVERY", 0.001)
    play = Stage(paused=True).playback
    looks = 0

    def look() -> None:
        nonlocal looks
        looks += 1
        if looks == 2000:
            play.stop()

    watchdog = Timer(30.0, play.ask, [play.stop])
    watchdog.start()
    before = signal.signal(signal.SIGALRM, lambda number, frame: None)
    # A little less than the wait: the signals come at all its moments, one after the other.
    signal.setitimer(signal.ITIMER_REAL, 0.001, 0.000997)
    try:
        play.run(look)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        watchdog.cancel()
    assert looks == 2000


def test_in_a_pause_messages_are_played_one_by_one_and_can_be_sought() -> None:
    stage = Stage(paused=True)
    play = stage.playback
    asked: list[Future[bool]] = [
        play.ask(play.play_next),
        play.ask(play.play_next),
        play.ask(lambda: play.seek(ORIGIN + 6 * SECOND - 1)),
        play.ask(play.play_next),
        play.ask(lambda: play.seek(ORIGIN + 9 * SECOND + 1)),
        play.ask(lambda: play.set_rate(-1.0)),
        play.ask(lambda: play.seek(ORIGIN + 9 * SECOND)),
        play.ask(play.play_next),
        play.ask(play.play_next),
    ]
    play.ask(play.stop)
    play.run()
    assert [answer.result(0) for answer in asked] == [
        *(True, True, True, True, False, False, True, True, False)
    ]
    assert stage.heard == [0, 1, 6, 9]


def test_what_was_said_last_before_is_said_first_wherever_it_is_gone_to() -> None:
    asked: list[int] = []
    heard: list[bytes] = []

    def read(at: int | None) -> Iterator[Recorded]:
        return (("/words", k, b"%d" % k) for k in range(at or 0, 10))

    def before(at: int) -> list[Recorded]:
        asked.append(at)
        return [("/map", 0, b"map %d" % at)]

    schedule = Schedule(7, 0.0, paused=True)
    play = Playback(
        read, lambda topic, data: heard.append(data), schedule, (0, 9), before=before, begin=7
    )
    play.ask(play.play_next)
    play.ask(lambda: play.seek(8))
    play.ask(play.schedule.resume)
    play.run()
    assert asked == [7, 8]
    assert heard == [b"map 7", b"7", b"map 8", b"8", b"9"]
    assert play.played == {"/map": 2, "/words": 3}


@pytest.mark.parametrize(("rate", "told"), [(1.0, True), (0.5, True), (1e9, False), (0.0, False)])
def test_a_long_wait_is_told_of_once(rate: float, told: bool) -> None:
    clock = FakeClock()
    waits: list[tuple[float, int]] = []
    looks: list[int] = []
    messages = [("/words", ORIGIN, b""), ("/words", ORIGIN + 100 * SECOND, b"")]
    schedule = Schedule(ORIGIN, rate, now=clock)
    play = Playback(
        lambda at: iter(messages),
        lambda topic, data: None,
        schedule,
        (ORIGIN, ORIGIN + 100 * SECOND),
        waits=lambda left, stamp: waits.append((left, stamp)),
    )

    def look() -> None:
        clock.time += 1.0
        looks.append(len(waits))
        if looks.count(1) == 3:  # it waits since three looks
            play.stop()

    play.run(look)
    expected = [(100.0 / rate, ORIGIN + 100 * SECOND)] if told else []
    assert waits == [(pytest.approx(left, abs=3.0), stamp) for left, stamp in expected]


def test_a_pause_is_no_long_wait() -> None:
    stage = Stage(paused=True)
    stage.playback._waits = lambda left, stamp: pytest.fail("told of a pause")
    stage.playback.run(stage.playback.stop)


def test_who_asks_after_the_end_is_answered() -> None:
    stage = Stage()
    stage.playback.run()
    stage.playback.schedule.pause()
    assert stage.playback.ask(stage.playback.play_next).result(0) is False


def test_a_long_wait_is_ended_by_who_asks_from_another_thread() -> None:
    stage = Stage(rate=1e-6)
    thread = Thread(target=stage.playback.run)
    thread.start()
    stage.playback.ask(lambda: stage.playback.seek(ORIGIN + 5 * SECOND)).result(60)
    stage.playback.ask(lambda: stage.playback.set_rate(1e9)).result(60)
    thread.join(60)
    assert not thread.is_alive()
    assert stage.heard[-5:] == [5, 6, 7, 8, 9]


@pytest.mark.parametrize("rate", [1e300, math.inf, math.nan, 0.0, -1.0])
def test_a_rate_that_the_option_refuses_is_refused(rate: float) -> None:
    play = Stage(rate=1.0).playback
    assert not play.set_rate(rate)
    assert play.schedule.rate == 1.0
    assert play.set_rate(1e9)


def test_a_slow_player_obeys_a_lower_rate_from_the_message_that_is_next() -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, 1000.0, now=clock)
    left: list[float] = []

    def publish(topic: str, data: bytes) -> None:
        clock.time += 1.0  # in which the schedule goes on by 1000 s
        if data == b"3":
            play.set_rate(1.0)
            play.ask(lambda: left.append(schedule.left(ORIGIN + 9 * SECOND)))
            play.ask(play.stop)

    messages = [("/topic", ORIGIN + k * SECOND, b"%d" % k) for k in range(10)]
    play = Playback(lambda _: iter(messages), publish, schedule, (ORIGIN, ORIGIN + 9 * SECOND))
    play.run()
    assert left == [pytest.approx(6.0)]


def test_the_clock_ticks_in_pauses_too_and_never_before_a_message_that_is_due() -> None:
    clock = FakeClock()
    schedule = Schedule(ORIGIN, 1.0, paused=True, now=clock)
    ticks: list[int] = []

    def tick(at: int) -> None:
        ticks.append(at)
        if len(ticks) == 2:
            schedule.resume()
        elif len(ticks) == 4:
            play.stop()
        clock.time += 100.0

    messages = [("/topic", ORIGIN + k * SECOND, b"") for k in (0, 1000)]
    play = Playback(
        lambda _: iter(messages),
        lambda topic, data: None,
        schedule,
        (ORIGIN, ORIGIN + 1000 * SECOND),
        meet=lambda: None,
        tick=tick,
        tick_every=1e-4,
    )
    play.run()
    assert ticks[:2] == [ORIGIN, ORIGIN]
    assert ticks == sorted(ticks)
    assert len(ticks) == 4


def test_the_clock_stops_at_the_end_of_the_bag() -> None:
    clock = FakeClock()
    messages = [("/topic", ORIGIN + k * SECOND, b"") for k in range(3)]
    ticks: list[int] = []

    def publish(topic: str, data: bytes) -> None:
        clock.time += 5.0  # slowly

    play = Playback(
        lambda _: iter(messages),
        publish,
        Schedule(ORIGIN, 1.0, now=clock),
        (ORIGIN, ORIGIN + 2 * SECOND),
        tick=ticks.append,
        tick_every=0.0,
    )
    play.run()
    assert ticks == sorted(ticks)
    assert ticks[-1] == ORIGIN + 2 * SECOND


def test_each_start_is_delayed() -> None:
    stage = Stage(loop=True)
    jumps: list[float] = []
    schedule = stage.playback.schedule
    jump = schedule.jump

    def noted(stamp: int, delay: float = 0.0) -> None:
        jumps.append(delay)
        jump(stamp)

    schedule.jump = noted  # type: ignore[method-assign]
    stage.playback._delay = 5.0
    stage.playback.run()
    assert [delay for delay in jumps if delay] == [5.0, 5.0, 5.0]
    assert stage.heard == [*range(10), *range(10), *range(5)]


LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=37,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
UNKNOWN = QoSProfile(depth=DEFAULT_DEPTH)


def recorded_qos(text: str) -> QoSProfile:
    return merged(recorded_profiles(text))


def test_qos_is_what_was_recorded() -> None:
    ours = Topic("/a", "b/msg/C", durability="transient_local", depth=37)
    assert recorded_qos(ours.qos_text()) == LATCHED
    old = "- history: 1\n  depth: 37\n  reliability: 1\n  durability: 1\n"
    assert recorded_qos(old) == LATCHED
    assert recorded_qos(old + "  deadline: {sec: 1, nsec: 0}\n" + old) == LATCHED
    sensor = recorded_qos("- history: keep_all\n  reliability: best_effort\n")
    assert sensor.history == HistoryPolicy.KEEP_ALL
    assert sensor.reliability == ReliabilityPolicy.BEST_EFFORT


@pytest.mark.parametrize(
    "text",
    ["", "[", "7", "- 7", "- depth: many", "- {durability: 1}\n- {durability: 2}"],
)
def test_qos_that_says_nothing_or_contradicts_itself_is_the_usual_one(text: str) -> None:
    assert recorded_qos(text) == UNKNOWN
