# SPDX-License-Identifier: Apache-2.0
"""What a user of ROS 2 expects of any node: namespaces, logs, parameters, /clock."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.context import Context
from rclpy.logging import LoggingSeverity
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from flock_interfaces.msg import BirdState
from flock_interfaces.srv import Resume
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.ros.endpoints import DrainedNode, latched
from flock_sim.ros.parameters.late_services import LateParameters
from support.bags import assert_stopped_as_the_reference, last_step
from support.terminal import Job, Terminal
from support.visitor import Visitor, visiting

LONG = ("--t-max", "1e7", "--record-every", "1000", "--no-record")
"""Options of a flight that ends when it is told to."""


@pytest.fixture
def visitor(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> Any:
    with visiting(terminal, monkeypatch) as one:
        yield one


def fly(terminal: Terminal, *options: object) -> Job:
    return terminal.start("fly", *options)


@pytest.mark.slow
def test_two_flocks_fly_in_two_namespaces_of_one_domain(
    terminal: Terminal, visitor: Visitor
) -> None:
    """The states of each are those of its own reference, and bags have the usual names."""
    flocks = {"left": ("--birds", 2), "fleet/right": ("--birds", 3, "--coupling", "all")}
    common = ("--t-max", 1e7, "--processes", 2)
    heard = {name: visitor.hear(BirdState, f"/{name}/bird_02/state") for name in flocks}
    stray = visitor.hear(BirdState, "/flock/bird_02/state")
    jobs = {}
    for name, flock in flocks.items():
        bag = ("--output", Path(name).name)
        jobs[name] = fly(terminal, *flock, *common, *bag, "--ros-args", "-r", f"__ns:=/{name}")
    visitor.until(lambda: all(states and states[-1].step > 300 for states in heard.values()))
    for name, job in jobs.items():
        assert visitor.ask(Trigger, f"/{name}/clock/stop").success
        done = job.wait()
        assert done.status == 0, done.stderr
        assert "ignores" not in done.stderr
    assert not stray
    for name, flock in flocks.items():
        assert_stopped_as_the_reference(terminal, flock[1], 10, *flock, bag=Path(name).name)


@pytest.mark.parametrize("service", ["clock/pause", "clock/resume"])
def test_a_namespace_moves_services_too(terminal: Terminal, visitor: Visitor, service: str) -> None:
    job = fly(terminal, "--birds", 2, *LONG, "--ros-args", "-r", "__ns:=/left")
    assert visitor.ask(Trigger, f"/left/{service}").success
    assert visitor.ask(Trigger, "/left/clock/stop").success
    assert job.wait().status == 0


@pytest.mark.slow
def test_watch_and_a_remapped_topic_in_a_namespace(terminal: Terminal, visitor: Visitor) -> None:
    ros = ("--ros-args", "-r", "__ns:=/left")
    heard = visitor.hear(BirdState, "/left/elsewhere")
    job = fly(terminal, "--birds", 2, *LONG, *ros, "-r", "bird_01/wing:=bird_01/span")
    # The wing of bird 1 is remapped in all nodes, so bird 2 hears it, and the flock flies.
    done = terminal.run("watch", "--json", *ros)
    assert done.status == 0, done.stderr
    assert done.json["birds"] == 2
    assert terminal.run("watch", "--json", "--timeout", 3).status == 1  # not in /flock
    visitor.until(lambda: visitor.node.count_publishers("/left/bird_01/span"))
    assert not visitor.node.count_publishers("/left/bird_01/wing")
    assert not heard
    assert visitor.ask(Trigger, "/left/clock/stop").success
    assert job.wait().status == 0


def test_play_moves_the_recorded_topics(terminal: Terminal, visitor: Visitor) -> None:
    terminal.well("reference", "--birds", 2, "--t-max", 20, "--output", "bag")
    heard = visitor.hear(BirdState, "/left/bird_01/state")
    ros = ("--ros-args", "-r", "__ns:=/left")
    job = terminal.start("play", "bag", "--rate", 0, "--paused", *ros)
    visitor.until(lambda: all(s.get_publisher_count() for s in visitor.node.subscriptions))
    visitor.ask(Resume, "/left/player/resume")
    visitor.until(lambda: len(heard) == 3)
    assert job.wait().status == 0


@pytest.mark.parametrize("processes", [1, 2])
def test_every_node_has_parameters_in_flight(
    terminal: Terminal, visitor: Visitor, processes: int
) -> None:
    job = terminal.start("fly", "--birds", 3, "--t-max", "1e7", "--record-every", 1000,
                         "--processes", processes, "--output", "bag")  # fmt: skip
    for node in ("bird_01", "bird_02", "bird_03", "clock", "recorder"):
        listed = visitor.ask(ListParameters, f"/flock/{node}/list_parameters").result.names
        assert {"birds", "record_every", "run_id"} <= set(listed)
        expected = {"record_every": 1000}
        if node.startswith("bird"):
            expected["index"] = int(node[-1])
        names = list(expected)
        told = visitor.ask(GetParameters, f"/flock/{node}/get_parameters", names=names).values
        assert [value.integer_value for value in told] == list(expected.values())
    visitor.stop(job)


def test_services_are_created_one_by_one_within_their_share_of_the_time(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("flock_sim.ros.parameters.late_services.time.monotonic", lambda: now[0])
    options = {"start_parameter_services": False, "enable_rosout": False}
    nodes = [DrainedNode(f"node_{k}", context=context, **options) for k in range(3)]
    declared: list[Any] = []

    def declare(node: Any) -> None:
        declared.append(node)
        now[0] += 1.0  # it takes a second

    late = LateParameters(nodes, declare)
    late.create_next()
    assert declared == []  # the flight has not begun
    late.begin()
    for k in range(3):
        late.create_next()
        late.create_next()
        assert declared == nodes[: k + 1]
        assert len({s.srv_name for s in nodes[k].services}) == 6
        now[0] += 18.5  # with the second above, 19.5 s: less than 20 times as long
        late.create_next()
        assert len(declared) == k + 1
        now[0] += 1.0
    for node in nodes:
        node.destroy_node()


def test_nodes_log_their_flight_to_rosout(terminal: Terminal, visitor: Visitor) -> None:
    heard: list[Log] = []
    # ROS keeps logs for late listeners for ten seconds. Each process of birds logs only once.
    visitor.node.create_subscription(Log, "/rosout", heard.append, latched(1000))
    job = fly(terminal, "--birds", 2, "--t-max", "1e7", "--record-every", 1000, "--output", "bag")
    visitor.until(lambda: any("the flock flies" in log.msg for log in heard))
    visitor.until(lambda: any("is in flight" in log.msg for log in heard))
    names = {"flock.clock", "flock.bird_01", "flock.recorder"}
    visitor.until(lambda: names <= {log.name for log in heard})
    assert visitor.ask(Trigger, "/flock/clock/stop").success
    visitor.until(lambda: any("the flight is over at step" in log.msg for log in heard))
    done = job.wait()
    assert done.status == 0
    assert "[INFO]" not in done.stderr + done.stdout
    assert all(log.level == LoggingSeverity.INFO for log in heard if "flies" in log.msg)


@pytest.mark.parametrize(("level", "shown"), [("info", True), ("warn", False)])
def test_log_level_and_files_of_a_node_by_hand(terminal: Terminal, level: str, shown: bool) -> None:
    words = ("-p", "birds:=1", "-p", "t_max:=10.0", "--log-level", level)
    clock = terminal.start("clock", "--ros-args", *words, "-p", "record:=false")
    bird = terminal.start("bird", "--ros-args", *words, "-p", "index:=1")
    told = [job.wait() for job in (clock, bird)]
    assert [done.status for done in told] == [0, 0]
    ends = ("the flight is over at step 10", "has ended its flight at step 10")
    for done, said in zip(told, ends, strict=True):
        assert (said in done.stderr) == shown
    logs = Path(terminal.environment["ROS_LOG_DIR"]).glob("*.log")
    text = "".join(log.read_text() for log in logs)
    assert ("the flight is over at step 10" in text) == shown


def test_a_node_logs_the_error_that_ends_it(terminal: Terminal) -> None:
    words = ("-p", "birds:=2", "-p", "run_id:=7", "-p", "index:=1")
    done = terminal.run("bird", "--timeout", 1, "--ros-args", *words)
    assert done.status == 1
    reason = done.stderr.rpartition("error: ")[2].strip()
    (log,) = Path(terminal.environment["ROS_LOG_DIR"]).glob("*.log")
    assert f"[flock.bird_01]: {reason}" in log.read_text()


def test_fly_shows_logs_if_asked(terminal: Terminal) -> None:
    done = terminal.well(
        *("fly", "--birds", 2, "--t-max", 20, "--no-record", "--json"),
        *("--ros-args", "--enable-stdout-logs"),
    )
    assert re.search(r"\[INFO\] \[[\d.]+\] \[flock\.clock\]: the flight is over", done.stderr)
    assert json.loads(done.stdout)["last_step"] == 20


def _nanoseconds(time: Clock) -> int:
    return int(time.clock.sec * 10**9 + time.clock.nanosec)


@pytest.mark.parametrize("every", [0, 1, 4])
def test_clock_is_as_fine_as_asked_and_the_flight_is_the_same(
    terminal: Terminal, visitor: Visitor, every: int
) -> None:
    """With record_every 10, every 4th step means the multiples of 4 and of 10."""
    configuration = FlockConfiguration(birds=2, t_max=1e7)
    flock = ("--birds", 2, "--record-every", 10)
    job = fly(terminal, *flock, "--t-max", 1e7, "--clock-every", every, "--output", "bag")
    visitor.until(lambda: last_step(terminal.directory / "bag") > 100)
    paused = visitor.ask(Trigger, "/flock/clock/pause")
    last = int(paused.message.rpartition(" ")[2])  # "the flight pauses at step 3000"
    due = [s for s in range(last + 1) if s % 10 == 0 or (every and s % every == 0)]
    stamps = [configuration.stamp(step) for step in due]
    heard = visitor.hear(Clock, "/clock", depth=topics.MOST_TIMES)
    visitor.until(lambda: heard and _nanoseconds(heard[-1]) == stamps[-1])
    told = [*map(_nanoseconds, heard)]
    assert len(told) > 10
    assert told == stamps[-len(told) :]
    visitor.stop(job)
    assert_stopped_as_the_reference(terminal, 2, 10, *flock)


def test_a_late_listener_gets_what_the_page_promises(terminal: Terminal, visitor: Visitor) -> None:
    """The last messages, as many as the depth of the topic, without a gap."""
    configuration = FlockConfiguration(birds=2, t_max=1e7, record_every=1)
    depth = topics.depth(topics.state_topic(1), configuration)
    assert depth == 1024
    job = fly(terminal, "--birds", 2, "--t-max", 1e7, "--record-every", 1, "--no-record")
    first = visitor.hear(BirdState, "/flock/bird_01/state", depth=1)
    visitor.until(lambda: first and first[-1].step > 2 * depth)
    paused = visitor.ask(Trigger, "/flock/clock/pause")
    last = int(paused.message.rpartition(" ")[2])  # "the flight pauses at step 3000"
    late = visitor.hear(BirdState, "/flock/bird_02/state", depth=5000)
    visitor.until(lambda: late and late[-1].step == last)
    steps = [state.step for state in late]
    assert steps[0] <= last - depth + 1
    assert steps == list(range(steps[0], last + 1))
    visitor.stop(job)


def test_states_are_in_the_frame_of_the_air(terminal: Terminal, visitor: Visitor) -> None:
    heard = visitor.hear(BirdState, "/flock/bird_01/state")
    job = fly(terminal, "--birds", 2, *LONG)
    visitor.until(lambda: heard)
    assert heard[0].header.frame_id == "world"
    visitor.stop(job)
