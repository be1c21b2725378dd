# SPDX-License-Identifier: Apache-2.0
"""Where ROS nodes look for each other, as the environment says it."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from flock_sim.command_line import note
from flock_sim.core.spelling import nearest
from flock_sim.errors import FlockError

DOMAIN = "ROS_DOMAIN_ID"
LAST_DOMAIN = 232
SAFE_DOMAINS = 101  # from 0: those whose ports no system gives to others

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
RANGES = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")
NARROW = ("LOCALHOST", "OFF")

NETWORK_HELP = "find, and be found by, nodes on other machines too"

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""What Fast DDS, up to version 2 and from 3 on, reads its settings from."""
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"


@contextmanager
def own_domain() -> Iterator[None]:
    """Hold a ROS domain on which no other `fly` of this machine is, if the environment names none.

    The first that is free, held by a name in the kernel's abstract socket namespace, which is free
    again when this process ends, however it does. One that the environment names is taken as it is:
    flights on one domain do not touch each other, and only listen to each other's noise.
    """
    chosen = os.environ.get(DOMAIN)
    with socket.socket(socket.AF_UNIX) as claim:
        for domain in [int(chosen)] if chosen else range(SAFE_DOMAINS):
            with suppress(OSError):
                claim.bind(f"\0flock-domain-{domain}")
                break
        else:
            domain = int(chosen or 0)
            note(f"another flight is on ROS domain {domain} too")
        if domain and not chosen:
            note(f"another flight is on ROS domain 0: this one has {DOMAIN}={domain}")
        os.environ[DOMAIN] = str(domain)
        yield


def prepare_discovery(network: bool = False) -> None:
    """Look for others on this machine only, unless `network` or the environment asks for more.

    Raises FlockError where the environment asks for what ROS does not have, or for less.
    """
    domain = os.environ.get(DOMAIN) or "0"
    if not (domain.isascii() and domain.isdigit() and int(domain) <= LAST_DOMAIN):
        raise FlockError(f"{DOMAIN} = {domain}: must be a whole number, 0..{LAST_DOMAIN}")
    reach = os.environ.get(RANGE) or ("SUBNET" if network else "LOCALHOST")
    if reach not in RANGES:
        raise FlockError(f"{RANGE} = {reach}: {nearest(reach, RANGES)}")
    if network and reach in NARROW:
        raise FlockError(f"{RANGE} = {reach} and --network exclude each other: leave one out")
    os.environ[RANGE] = reach
    _tell_fast_dds("network.xml" if network else "machine.xml")


def _tell_fast_dds(file: str) -> None:
    """Give Fast DDS our settings in `file`, unless the environment has some."""
    if not any(os.environ.get(name) for name in (*PROFILES, TRANSPORTS)):
        settings = Path(get_package_share_directory("flock_sim")) / file
        os.environ.update(dict.fromkeys(PROFILES, str(settings)))
