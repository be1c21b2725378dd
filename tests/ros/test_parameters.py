# SPDX-License-Identifier: Apache-2.0
"""Other nodes can read a node's parameters, at rest and in flight."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from flock_sim.configuration.flock_configuration import KEYS, MEANING, FlockConfiguration
from flock_sim.configuration.operation import DEFAULTS, OPERATION
from flock_sim.ros.endpoints import latched
from flock_sim.ros.log import ros_context
from flock_sim.ros.parameters.declared import declare, descriptor
from support.terminal import Terminal
from support.visitor import tell_fast_dds

DEADLINE = 60.0
"""Time, in s, within which a node must answer."""


def ask(node: Node, kind: Any, name: str, request: Any) -> Any:
    """Call a service, and return what it answers."""
    client = node.create_client(kind, name)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        assert client.wait_for_service(DEADLINE), name
        future = client.call_async(request)
        executor.spin_until_future_complete(future, DEADLINE)
        assert future.done(), f"{name} gave no answer"
        return future.result()
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_client(client)


def _until_in_flight(node: Node) -> None:
    """Wait until simulated time goes on."""
    times: list[int] = []
    clock = node.create_subscription(
        Clock, "/clock", lambda told: times.append(told.clock.sec), latched(10)
    )
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    deadline = time.monotonic() + DEADLINE
    while not times or times[-1] < 1:
        assert time.monotonic() < deadline, "no flight has begun"
        executor.spin_once(timeout_sec=0.1)
    executor.remove_node(node)
    executor.shutdown()
    node.destroy_subscription(clock)


@pytest.fixture
def asker(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    """A node of this process, on the domain of the terminal."""
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOG_DIR"):
        monkeypatch.setenv(name, terminal.environment[name])
    tell_fast_dds(monkeypatch)
    context = ros_context()
    node = Node("asker", context=context, start_parameter_services=False, enable_rosout=False)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def test_all_that_a_node_can_be_given_has_a_meaning() -> None:
    for name in (*FlockConfiguration().parameters(), *OPERATION):
        assert descriptor(name).description


def test_every_default_is_within_its_range(context: Context) -> None:
    node = Node("any", context=context, start_parameter_services=False, enable_rosout=False)
    own = OPERATION.keys() - {"indices"}
    declare(node, FlockConfiguration(), {**DEFAULTS, "index": 1}, sorted(own))
    told = {name: p.value for name, p in node.get_parameters_by_prefix("").items()}
    assert told["birds"] == 13
    assert told["span_ratios"] == told["perturbations"] == [""]
    assert told.keys() >= KEYS.keys() | own
    node.destroy_node()


def test_a_waiting_clock_tells_what_it_was_given(terminal: Terminal, asker: Node) -> None:
    job = terminal.start("clock", "--ros-args", "-p", "birds:=5", "-p", "t_max:=100")
    job.until_connected()
    listed = ask(asker, ListParameters, "/flock/clock/list_parameters", ListParameters.Request())
    assert set(listed.result.names) >= KEYS.keys() | {"window", "record", "timeout"}
    asked = DescribeParameters.Request(names=["birds", "dt", "coupling"])
    birds, dt, coupling = ask(
        asker, DescribeParameters, "/flock/clock/describe_parameters", asked
    ).descriptors
    assert isinstance(birds, ParameterDescriptor)
    assert (birds.type, birds.description) == (
        ParameterType.PARAMETER_INTEGER,
        MEANING["birds"],
    )
    assert birds.integer_range[0].from_value == 1
    assert (dt.floating_point_range[0].from_value, dt.additional_constraints) == (
        0.0,
        "finite and above 0",
    )
    assert coupling.additional_constraints == "one of nearest, all"
    assert all(one.read_only for one in (birds, dt, coupling))
    values = ask(
        asker,
        GetParameters,
        "/flock/clock/get_parameters",
        GetParameters.Request(names=["birds", "t_max"]),
    ).values
    assert (values[0].integer_value, values[1].double_value) == (5, 100.0)
    job.interrupt()
    assert job.wait().status == 130


@pytest.mark.parametrize(
    ("rules", "names"),
    [([], ["_clock_parameters", "clock"]), (["-r", "__node:=time"], ["time"])],
    ids=["as usual", "renamed"],
)
def test_the_node_that_reads_the_parameters_is_hidden_or_gone(
    terminal: Terminal, asker: Node, rules: list[str], names: list[str]
) -> None:
    """ROS hides names that begin with an underscore. No two nodes may have the same name."""
    job = terminal.start("clock", "--ros-args", "-p", "birds:=5", *rules)
    deadline = time.monotonic() + DEADLINE
    while (known := sorted(asker.get_node_names())) != sorted(["asker", *names]):
        assert time.monotonic() < deadline, known
        time.sleep(0.05)
    job.interrupt()
    assert job.wait().status == 130


def test_a_bird_in_flight_tells_and_can_t_be_changed(terminal: Terminal, asker: Node) -> None:
    flock = ["--ros-args", "-p", "birds:=2", "-p", "t_max:=1e7", "-p", "record:=false"]
    jobs = [
        terminal.start("clock", *flock),
        *(terminal.start("bird", *flock, "-p", f"index:={bird}") for bird in (1, 2)),
    ]
    _until_in_flight(asker)
    get = GetParameters.Request(names=["index", "t_max"])
    index, t_max = ask(asker, GetParameters, "/flock/bird_02/get_parameters", get).values
    assert (index.integer_value, t_max.double_value) == (2, 1e7)
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=0.5)
    change = SetParameters.Request(parameters=[Parameter(name="dt", value=value)])
    (result,) = ask(asker, SetParameters, "/flock/bird_02/set_parameters", change).results
    assert not result.successful
    assert "read-only" in result.reason
    for job in jobs:
        job.interrupt()
    assert [job.wait().status for job in jobs] == [130, 130, 130]
