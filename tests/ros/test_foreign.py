# SPDX-License-Identifier: Apache-2.0
"""Other publishers on a flock's domain and topics change no bit of its flight."""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from random import Random
from typing import Any

import pytest
from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import BirdStage, BirdState, BirdWing, Checkpoint, Grant, Progress
from flock_sim.messages import topics
from flock_sim.ros.endpoints import latched
from support.bags import assert_equal, assert_stopped_as_the_reference, last_step
from support.terminal import Job, Terminal
from support.visitor import Visitor, values

BIRD = "flock_sim.nodes.bird_process"
EVERY = 10

FORGED = 10_000
"""Messages that are forged."""

GROWTH = 30.0
"""Most, in MB, that a process may grow by while it hears them: they are 2 MB in all, and each that
waits in a queue costs several times its length; a copy kept of each in every queue of a node, and
never freed, would be no more than that, and numpy or numba loaded late some MB."""

KINDS: dict[str, Any] = {
    topics.stage_topic(2): BirdStage,
    topics.state_topic(2): BirdState,
    topics.wing_topic(1): BirdWing,
    topics.GRANT_TOPIC: Grant,
    topics.PROGRESS_TOPIC: Progress,
    topics.CHECKPOINT_TOPIC: Checkpoint,
    topics.CLOCK_TOPIC: Clock,
}

RUN_ID_AT = 4
"""Where the run id stands in every message but times, which have none, and states."""


def test_two_flights_on_one_domain_do_not_touch_each_other(terminal: Terminal) -> None:
    flock = ("--birds", 2, "--record-every", EVERY)
    flights = {
        "one": (*flock, "--t-max", 3000, "--dt", 1.0, "--span-ratio", "2=0.97,1.03"),
        "other": (*flock, "--t-max", 1500, "--dt", 0.5, "--span-ratio", "2=0.9,1.1"),
    }
    jobs = {
        name: terminal.start("fly", *flight, "--output", name) for name, flight in flights.items()
    }
    for job in jobs.values():
        done = job.wait()
        assert done.status == 0, done.stderr
    for name, flight in flights.items():
        terminal.well("reference", *flight, "--output", f"{name}-again")
        assert_equal(terminal, name, f"{name}-again", 2 * (3000 // EVERY + 1))


@pytest.mark.slow
def test_two_flocks_by_hand_with_run_ids_do_not_touch_each_other(terminal: Terminal) -> None:
    flock = ("-p", "birds:=2", "-p", "t_max:=1000.0")
    ratios = {7: "0.97", 8: "1.03"}
    jobs: list[Job] = []
    for run_id, ratio in ratios.items():
        how = ("--ros-args", *flock, "-p", f"span_ratios:=['2={ratio}']", "-p", f"run_id:={run_id}")
        jobs += [
            terminal.start("clock", *how),
            terminal.start("recorder", *how, "-p", f"output:=run-{run_id}"),
            terminal.start("bird", *how, "-p", "index:=1"),
            terminal.start("bird", *how, "-p", "index:=2"),
        ]
    for job in jobs:
        done = job.wait()
        assert done.status == 0, done.stderr
    for run_id, ratio in ratios.items():
        flight = ("--birds", 2, "--t-max", 1000, "--span-ratio", f"2={ratio}")
        terminal.well("reference", *flight, "--output", f"reference-{run_id}")
        assert_equal(terminal, f"run-{run_id}", f"reference-{run_id}", 2 * 101)


@pytest.mark.slow
def test_forged_messages_of_all_kinds_change_no_bit(terminal: Terminal, visitor: Visitor) -> None:
    flock = ("--birds", 3, "--t-max", 1e8, "--record-every", EVERY, "--span-ratio", "2=0.97")
    heard = {topic: visitor.hear(kind, topic, raw=True, depth=1) for topic, kind in KINDS.items()}
    outlets = {
        topic: visitor.node.create_publisher(kind, topic, latched(1))
        for topic, kind in KINDS.items()
    }
    clock, recorder = (visitor.diagnostics(f"flock: {who}") for who in ("clock", "recorder"))
    job = terminal.start("fly", *flock, "--processes", 3, "--output", "bag")
    visitor.until(lambda: all(heard.values()) and last_step(terminal.directory / "bag") > 0)
    visitor.until(lambda: all(outlet.get_subscription_count() > 1 for outlet in outlets.values()))
    genuine = {topic: data[-1] for topic, data in heard.items()}
    birds = job.workers(BIRD)
    before = {pid: resident(pid) for pid in birds}
    for topic, data in islice(forged(Random(5), genuine), FORGED):
        outlets[topic].publish(data)
    for told in (clock, recorder):
        visitor.until(lambda told=told: told and int(values(told[-1])["ignored"]) > 100)
    grown = {pid: resident(pid) - before[pid] for pid in birds}
    assert max(grown.values()) < GROWTH, grown
    visitor.stop(job)
    done = job.wait()
    warnings = Counter(re.findall(r"^warning: .* ignores messages .*$", done.stderr, re.MULTILINE))
    assert {line.split()[1] for line in warnings} >= {"bird_01", "bird_03", "clock", "recorder"}
    assert set(warnings.values()) == {1}, warnings
    assert_stopped_as_the_reference(terminal, 3, EVERY, *flock)


def forged(random: Random, genuine: dict[str, bytes]) -> Iterator[tuple[str, bytes]]:
    """Yield for ever (topic, message), none of which its reader may take for true."""
    names = sorted(genuine)
    while True:
        topic = random.choice(names)
        data = bytearray(genuine[topic])
        way = random.choice(["noise", "noise of its length", "cut short", "too long", "mutated"])
        if way == "noise":
            # DDS itself refuses to send more than a time can be.
            longest = len(data) if topic == topics.CLOCK_TOPIC else 400
            yield topic, random.randbytes(random.randrange(4, longest))
        elif way == "noise of its length":
            yield topic, bytes(data[:4]) + random.randbytes(len(data) - 4)
        elif way == "cut short":
            # A text that ends with nothing but its zero is a message; what has none is no harm.
            yield topic, bytes(data[: random.randrange(4, len(data) // 2)])
        elif way == "too long" and topic in (topics.stage_topic(2), topics.state_topic(2)):
            yield topic, bytes(data) + random.randbytes(random.randrange(1, 200))
        elif topic != topics.CLOCK_TOPIC:
            yield topic, mutated(random, topic, data)


def mutated(random: Random, topic: str, data: bytearray) -> bytes:
    """Return a message of another run or, where it says so, of an epoch that is over."""
    run_id_at = len(data) - 12 if topic == topics.state_topic(2) else RUN_ID_AT
    epoch_at = {
        topics.stage_topic(2): 20,
        topics.state_topic(2): len(data) - 4,
        topics.GRANT_TOPIC: 36,
        topics.PROGRESS_TOPIC: 20,
        topics.CHECKPOINT_TOPIC: 20,
    }
    if topic in epoch_at and random.random() < 0.5:
        (epoch,) = struct.unpack_from("<I", data, epoch_at[topic])
        struct.pack_into("<I", data, epoch_at[topic], random.randrange(epoch))
    else:
        struct.pack_into("<Q", data, run_id_at, random.randrange(1, 2**63))
    if topic in (topics.stage_topic(2), topics.wing_topic(1)):
        value = random.choice([float("nan"), float("inf"), -1e308])
        struct.pack_into("<d", data, len(data) - 8, value)
    return bytes(data)


def resident(pid: int) -> float:
    """Return the memory of a process, in MB."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    assert found
    return int(found[1]) / 1000.0
