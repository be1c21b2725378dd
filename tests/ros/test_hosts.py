# SPDX-License-Identifier: Apache-2.0
"""A flock on several hosts: discovery over a network, and the failures of discovery."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from flock_sim.ros.discovery import TRANSPORTS
from support.hosts import Host, Traffic, Weather, joined_hosts, unavailable
from support.terminal import Job, Terminal

STEPS = 20

CLEAR = Weather()
ROUGH = Weather(loss=0.05, delay=(0.010, 0.030))

OF_OTHERS = {TRANSPORTS: "UDPv4"}
"""What others are told, who would use shared memory else: hosts have that in common here."""

FEW = 4
"""How many processes of a host that is named Fast DDS looks for, unless it is told to look on."""

OTHER_NODES = """
import sys, rclpy
from rclpy.context import Context
from rclpy.node import Node
nodes = []
for number in range(int(sys.argv[1])):
    rclpy.init(context=(context := Context()))
    nodes.append(Node(f"other_{number}", context=context))
print("up", flush=True)
sys.stdin.read()
"""

Join = Callable[[int, Weather], tuple[list[Host], Traffic]]


@pytest.fixture
def join() -> Iterator[Join]:
    """Give what joins hosts."""
    if reason := unavailable():
        pytest.skip(reason)
    with ExitStack() as stack:
        yield lambda count, weather: stack.enter_context(joined_hosts(count, weather))


@pytest.fixture
def travellers(terminal: Terminal) -> Terminal:
    """A terminal whose environment leaves it to the tools where they look for others."""
    del terminal.environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]
    return terminal


def configure(terminal: Terminal, birds: int) -> None:
    """Write a configuration file for a short flight of two members."""
    keys = (
        f"birds: {birds}", f"t_max: {STEPS}.0", "record_every: 1", 'span_ratios: ["2=0.97,1.02"]'
    )  # fmt: skip
    lines = ["/**:", "  ros__parameters:", *(f"    {key}" for key in keys)]
    (terminal.directory / "flock.yaml").write_text("\n".join(lines))


def start(terminal: Terminal, host: Host, tool: str, *given: str, network: bool) -> Job:
    """Start a node by hand on a host."""
    return terminal.start(
        *(tool, *["--network"][:network], "--ros-args", *given, "--params-file", "flock.yaml"),
        enter=host.enter(terminal.directory),
    )


def fly_as_the_reference(terminal: Terminal, hosts: Sequence[Host], birds: int) -> None:
    """Fly on three hosts: clock and recorder, the left half of the birds, and the right half."""
    configure(terminal, birds)
    jobs = [
        start(terminal, hosts[0], "clock", network=True),
        start(terminal, hosts[0], "recorder", "-p", "output:=bag", network=True),
    ]
    for bird in range(1, birds + 1):
        host = hosts[1] if 2 * bird <= birds else hosts[2]
        jobs.append(start(terminal, host, "bird", "-p", f"index:={bird}", network=True))
    try:
        ends = [job.wait() for job in jobs]
    except AssertionError as late:
        raise AssertionError("\n".join(job.stderr for job in jobs)) from late
    for done in ends:
        assert done.status == 0, done.stderr
    terminal.well("reference", "--config", "flock.yaml", "--output", "reference")
    done = terminal.run("compare", "bag", "reference", "--json")
    assert done.status == 0, done.stdout
    assert done.json["messages"] == birds * (STEPS + 1)


@contextmanager
def other_nodes(terminal: Terminal, host: Host) -> Iterator[None]:
    """Have nodes on a host that are nobody's business, one for each place in FEW."""
    command = [sys.executable, "-P", "-c", OTHER_NODES, str(FEW)]
    with subprocess.Popen(
        [*host.enter(terminal.directory), *command],
        env={**terminal.environment, **OF_OTHERS},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as crowd:
        assert crowd.stdout is not None
        assert crowd.stdout.readline() == b"up\n"
        yield


@contextmanager
def discovery_server(terminal: Terminal, host: Host) -> Iterator[None]:
    """Run the discovery server of Fast DDS on a host."""
    tool = Path(sys.executable).with_name("fast-discovery-server")
    found = tool if tool.exists() else shutil.which("fast-discovery-server")
    if found is None:
        pytest.skip("there is no fast-discovery-server")
    command = [str(found), "--server-id", "0", "--udp-address", host.address]
    with subprocess.Popen(
        [*host.enter(terminal.directory), *command],
        env={**terminal.environment, **OF_OTHERS},
        stdout=subprocess.DEVNULL,
    ) as server:
        try:
            yield
        finally:
            server.terminate()


@pytest.mark.slow
def test_a_network_that_loses_delays_and_reorders_changes_no_bit(
    travellers: Terminal, join: Join
) -> None:
    hosts, traffic = join(3, ROUGH)
    fly_as_the_reference(travellers, hosts, birds=4)
    assert traffic.lost > 0
    assert traffic.overtaken > 0
    assert traffic.shortest >= ROUGH.delay[0]


@pytest.mark.slow
def test_hosts_that_are_named_find_each_other_without_multicast_however_busy_they_are(
    travellers: Terminal, join: Join
) -> None:
    hosts, _ = join(3, Weather(multicast=False))
    travellers.environment["ROS_STATIC_PEERS"] = ";".join(host.address for host in hosts)
    with ExitStack() as stack:
        for host in hosts[1:]:
            stack.enter_context(other_nodes(travellers, host))
        fly_as_the_reference(travellers, hosts, birds=2)


def test_a_discovery_server_brings_hosts_together_without_multicast(
    travellers: Terminal, join: Join
) -> None:
    hosts, _ = join(3, Weather(multicast=False))
    with discovery_server(travellers, hosts[0]):
        travellers.environment["ROS_DISCOVERY_SERVER"] = f"{hosts[0].address}:11811"
        fly_as_the_reference(travellers, hosts, birds=2)


@pytest.mark.slow
def test_no_other_host_hears_of_a_flock_that_was_not_told_to_use_the_network(
    travellers: Terminal, join: Join
) -> None:
    hosts, traffic = join(2, CLEAR)
    configure(travellers, birds=2)
    clock = start(travellers, hosts[0], "clock", network=False)
    bird = start(travellers, hosts[1], "bird", "-p", "index:=1", network=False)
    clock.until_said("waiting for bird_01")
    bird.until_said("waits for the clock's first grant")
    assert traffic.sent == 0
    for job in (clock, bird):
        job.interrupt()
        assert job.wait().status == 130
