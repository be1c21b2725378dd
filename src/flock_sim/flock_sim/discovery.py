# SPDX-License-Identifier: Apache-2.0
"""Where ROS nodes look for each other, as the environment says it."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from flock_sim.command_line import note
from flock_sim.core.spelling import nearest
from flock_sim.errors import FlockError

DOMAIN = "ROS_DOMAIN_ID"
LAST_DOMAIN = 232
SAFE_DOMAINS = 101  # from 0: those whose ports no system gives to others

FIRST_PORT, PORTS = 7400, 250
"""The UDP ports of domain 0 begin here, and each domain has so many."""

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
RANGES = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")
NARROW = ("LOCALHOST", "OFF")

ELSEWHERE = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER")
"""What names others to look for, whatever the range."""

NETWORK_HELP = "find, and be found by, nodes on other machines too"

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""What Fast DDS, up to version 2 and from 3 on, reads its settings from."""
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"

FAST_DDS = "rmw_fastrtps"
"""What the RMW_IMPLEMENTATION begins with, unless somebody has chosen another one."""


@contextmanager
def own_domain() -> Iterator[None]:
    """Hold a ROS domain on which no other `fly` of this machine is, if the environment names none.

    The first that is free. One that the environment names is taken as it is: flights on one domain
    do not touch each other, and only listen to each other's noise.
    """
    chosen = os.environ.get(DOMAIN)
    with held_domain([int(chosen)] if chosen else range(SAFE_DOMAINS)) as held:
        domain = int(chosen or 0) if held is None else held
        if held is None:
            note(f"another flight is on ROS domain {domain} too")
        elif domain and not chosen:
            note(f"another flight is on ROS domain 0: this one has {DOMAIN}={domain}")
        os.environ[DOMAIN] = str(domain)
        yield


@contextmanager
def held_domain(domains: Iterable[int]) -> Iterator[int | None]:
    """Hold the first of `domains` that no flight of this machine holds; None where all are held."""
    with socket.socket(socket.AF_UNIX) as claim:
        yield next((domain for domain in domains if claimed(claim, f"domain-{domain}")), None)


def claimed(claim: socket.socket, what: str) -> bool:
    """Whether `claim`, a Unix socket, has `what` from now on until it is closed.

    It is a name in the kernel's abstract socket namespace, which is free again when its holder
    ends, however it does. Where a system has no such namespace, nothing can be claimed.
    """
    try:
        claim.bind(f"\0flock-{what}")
    except OSError:
        return False
    return True


def quiet_domains() -> list[int]:
    """Return the domains from 1 on that nobody on this machine talks on: each has its UDP ports."""
    lines = Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]
    ports = [int(line.split()[1].partition(":")[2], 16) for line in lines]
    busy = {(port - FIRST_PORT) // PORTS for port in ports}
    return sorted(set(range(1, SAFE_DOMAINS)) - busy)


def prepare_discovery(network: bool = False) -> None:
    """Look for others on this machine only, unless `network` or the environment asks for more.

    Raises FlockError where the environment asks for what ROS does not have, or for less.
    """
    domain = os.environ.get(DOMAIN) or "0"
    if not (domain.isascii() and domain.isdigit() and int(domain) <= LAST_DOMAIN):
        raise FlockError(f"{DOMAIN} = {domain}: must be a whole number, 0..{LAST_DOMAIN}")
    _forget_what_we_told()
    reach = os.environ.get(RANGE) or ("SUBNET" if network else "LOCALHOST")
    if reach not in RANGES:
        raise FlockError(f"{RANGE} = {reach}: {nearest(reach, RANGES)}")
    if network and reach in NARROW:
        raise FlockError(f"{RANGE} = {reach} and --network exclude each other: leave one out")
    os.environ[RANGE] = reach
    _tell_fast_dds(reach)


def _tell_fast_dds(reach: str) -> None:
    """Give Fast DDS our settings for a discovery range, unless the environment has some.

    Those for this machine alone stand in the stead of what ROS makes of LOCALHOST, which adds
    shared memory to any transports. They know of no hosts that the environment names besides.
    """
    told = any(os.environ.get(name) for name in (*PROFILES, TRANSPORTS))
    if told or not (os.environ.get("RMW_IMPLEMENTATION") or FAST_DDS).startswith(FAST_DDS):
        return
    here = reach == "LOCALHOST" and not any(os.environ.get(name) for name in ELSEWHERE)
    if here:
        os.environ[RANGE] = "SYSTEM_DEFAULT"
    settings = _settings("machine.xml" if here else "network.xml")
    os.environ.update(dict.fromkeys(PROFILES, settings))


def _forget_what_we_told() -> None:
    """Take back what this process, or who started it, has told of this machine alone."""
    if os.environ.get(PROFILES[0]) == _settings("machine.xml"):
        for name in (RANGE, *PROFILES):
            os.environ.pop(name, None)


def _settings(file: str) -> str:
    """Return the path of our settings of Fast DDS in `file`."""
    return str(Path(get_package_share_directory("flock_sim")) / file)
