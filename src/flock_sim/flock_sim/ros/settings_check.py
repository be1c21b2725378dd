# SPDX-License-Identifier: Apache-2.0
"""Check that Fast DDS has loaded our settings.

If Fast DDS does not know a word in its settings, it loads none of them and uses its defaults: it
listens on every network of the machine, and uses shared memory. Its log lines about this are easily
missed, so the check uses its sockets and memory.
"""

from __future__ import annotations

import os
import socket
import sys
from contextlib import suppress
from pathlib import Path

from flock_sim.errors import FlockError
from flock_sim.ros.discovery import (
    FIRST_PORT,
    NARROW,
    PORTS,
    PROFILES,
    RANGE,
    is_fast_dds_3,
    on_loopback_alone,
    our_settings,
)

LOOPBACK = "127.0.0.1"

SHARED_MEMORY = ("/dev/shm/fastrtps_", "/dev/shm/fastdds_")
"""Prefixes of the shared memory files of Fast DDS: up to version 2, and from 3 on."""


def check_settings(domain: int) -> None:
    """Raise FlockError if this process, with a node on `domain`, does not use our settings.

    Settings that are not from us are not checked: the user is responsible for them.
    """
    if on_loopback_alone():
        ports = range(FIRST_PORT + PORTS * domain, FIRST_PORT + PORTS * (domain + 1))
        open_to = {address for address, port in udp_sockets() if port in ports} - {LOOPBACK}
        found = f"listens on {' and '.join(sorted(open_to))}, not on {LOOPBACK} alone"
        taken = not open_to
    else:  # with a narrow range, ROS adds shared memory to our settings
        found = "uses shared memory"
        taken = not our_settings() or os.environ.get(RANGE) in NARROW or not shared_memory()
    if not taken:
        name = PROFILES[is_fast_dds_3()]
        raise FlockError(
            f"Fast DDS {found}: it has not loaded {os.environ[name]}, which it loads before the "
            f"first node of a process; set {name} to a file that it can load"
        )


def udp_sockets(process: int | str = "self") -> set[tuple[str, int]]:
    """Return address and port of each UDP socket of a process; none if it has ended."""
    links, table = set(), ""
    with suppress(OSError):
        for link in Path(f"/proc/{process}/fd").iterdir():
            with suppress(OSError):  # this file was closed meanwhile
                links.add(os.readlink(link))
        table = Path(f"/proc/{process}/net/udp").read_text(encoding="ascii")
    found = set()
    for line in table.splitlines()[1:]:
        _, local, _, _, _, _, _, _, _, inode, *_ = line.split()
        if f"socket:[{inode}]" in links:
            address, _, port = local.partition(":")
            native = int(address, 16).to_bytes(4, sys.byteorder)
            found.add((socket.inet_ntoa(native), int(port, 16)))
    return found


def shared_memory(process: int | str = "self") -> set[str]:
    """Return the shared memory files of Fast DDS that a process has mapped."""
    try:
        maps = Path(f"/proc/{process}/maps").read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:
        return set()
    return {word for word in maps.split() if word.startswith(SHARED_MEMORY)}
