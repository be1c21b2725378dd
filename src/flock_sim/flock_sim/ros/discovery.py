# SPDX-License-Identifier: Apache-2.0
"""Discovery settings of ROS nodes, from the environment."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from flock_sim.console.arguments import note
from flock_sim.errors import FlockError, nearest
from flock_sim.outside.printing import shown

DOMAIN = "ROS_DOMAIN_ID"
LAST_DOMAIN = 232
SAFE_DOMAINS = 101  # from 0: domains whose ports no system gives to other programs

FIRST_PORT, PORTS = 7400, 250
"""First UDP port of domain 0, and number of ports per domain."""

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
RANGES = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")
NARROW = ("LOCALHOST", "OFF")

LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
"""Variable of ROS before Iron: 1 means LOCALHOST. It still overrides the range."""

ELSEWHERE = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER")
"""Variables that name further hosts to search, independent of the range."""
ELSEWHERE_EXAMPLES = dict(zip(ELSEWHERE, ("10.0.0.2;robot.local", "10.0.0.2:11811"), strict=True))

MIDDLEWARE = "RMW_IMPLEMENTATION"

NETWORK_HELP = "exchange messages with nodes on other machines too"

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables for the settings file of Fast DDS: up to version 2, and from 3 on. ROS with version 3
reads the first as well, and warns."""
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"

FAST_DDS = "rmw_fastrtps"
"""Prefix of the default RMW_IMPLEMENTATION."""


@contextmanager
def own_domain() -> Iterator[None]:
    """Hold the first ROS domain without another `fly` on this machine.

    A domain that the environment names is used as it is. Flights on one domain do not affect each
    other; they only receive each other's messages.
    """
    chosen = os.environ.get(DOMAIN)
    with held_domain([int(chosen)] if chosen else range(SAFE_DOMAINS)) as held:
        domain = int(chosen or 0) if held is None else held
        if held is None:
            note(f"another flight uses ROS domain {domain} too")
        elif domain and not chosen:
            note(f"another flight uses ROS domain 0: this one uses {DOMAIN}={domain}")
        os.environ[DOMAIN] = str(domain)
        yield


@contextmanager
def held_domain(domains: Iterable[int]) -> Iterator[int | None]:
    """Hold the first of `domains` that no flight of this machine holds; None if all are held."""
    with socket.socket(socket.AF_UNIX) as claim:
        yield next((domain for domain in domains if claimed(claim, f"domain-{domain}")), None)


def claimed(claim: socket.socket, what: str) -> bool:
    """Whether `claim`, a Unix socket, holds `what` from now on until it is closed.

    `what` is a name in the kernel's abstract socket namespace. It is free again when its holder
    ends, for whatever reason. On a system without such a namespace, nothing can be claimed.
    """
    try:
        claim.bind(f"\0flock-{what}")
    except OSError:
        return False
    return True


def quiet_domains() -> list[int]:
    """Return the domains from 1 on whose UDP ports no process on this machine uses."""
    lines = Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]
    ports = [int(line.split()[1].partition(":")[2], 16) for line in lines]
    busy = {(port - FIRST_PORT) // PORTS for port in ports}
    return sorted(set(range(1, SAFE_DOMAINS)) - busy)


def prepare_discovery(network: bool = False) -> None:
    """Restrict discovery to this machine, unless `network` or the environment sets more.

    Raises FlockError if the environment has a value that ROS does not know, or too
    narrow a range.
    """
    check_middleware()
    _check_domain(os.environ.get(DOMAIN) or "0")
    _forget_what_we_told()
    reach = _asked_reach(network)
    _check_elsewhere()
    os.environ[RANGE] = reach
    _tell_fast_dds(reach)


def check_middleware() -> None:
    """Raise FlockError if ROS lacks the middleware that the environment names."""
    asked = os.environ.get(MIDDLEWARE)
    if not asked:
        return
    from ament_index_python import get_resources

    try:
        known = sorted(set(get_resources("rmw_typesupport")) - {"rmw_implementation"})
    except OSError:
        return  # without an index, ROS itself must report it
    if asked not in known:
        raise FlockError(
            f"{MIDDLEWARE} = {asked}: is not installed; unset it, or set it to an installed one: "
            f"{', '.join(known)}"
        )


def _check_domain(domain: str) -> None:
    """Raise FlockError unless `domain` is a valid number that all programs read alike."""
    digits = domain.isascii() and domain.isdigit()
    if not digits or len(domain) > 10 or int(domain) > LAST_DOMAIN:
        raise FlockError(f"{DOMAIN} = {shown(domain)}: must be a whole number, 0..{LAST_DOMAIN}")
    if str(int(domain)) != domain:
        raise FlockError(
            f"{DOMAIN} = {domain}: some programs read it as octal: must be a whole number, "
            f"0..{LAST_DOMAIN}, without leading zeros"
        )


def _asked_reach(network: bool) -> str:
    """Return the requested discovery range, as a value that ROS knows."""
    reach = os.environ.get(RANGE) or ("SUBNET" if network else "LOCALHOST")
    if reach not in RANGES:
        raise FlockError(f"{RANGE} = {reach}: {nearest(reach, RANGES)}")
    if network and reach in NARROW:
        raise FlockError(f"{RANGE} = {reach} and --network exclude each other: leave one out")
    if os.environ.get(LOCALHOST_ONLY) == "1":
        if network:
            raise FlockError(
                f"{LOCALHOST_ONLY} = 1 and --network exclude each other: leave one out"
            )
        # Translate it to the current variables, so that nodes here agree with others.
        for name in (LOCALHOST_ONLY, ELSEWHERE[0]):
            os.environ.pop(name, None)
        return "LOCALHOST"
    if reach == "OFF":
        raise FlockError(
            f"{RANGE} = OFF: nodes would not discover each other; set it to "
            "LOCALHOST, or leave it out"
        )
    return reach


def _check_elsewhere() -> None:
    """Raise FlockError if the environment names an unknown host."""
    for name, example in ELSEWHERE_EXAMPLES.items():
        for entry in filter(None, os.environ.get(name, "").split(";")):
            if not _is_host(entry, port=name != ELSEWHERE[0]):
                raise FlockError(
                    f"{name} = {os.environ[name]}: {entry!r} is not a known host; give "
                    f"names or addresses such as {example}"
                )


def _is_host(entry: str, port: bool) -> bool:
    """Whether `entry` is a known host; with `port`, a port may follow it."""
    if port and "[" in entry:
        return True  # a locator of Fast DDS, such as TCPv4:[10.0.0.2]:42100
    host, _, number = entry.partition(":") if port and entry.count(":") == 1 else (entry, "", "0")
    try:
        socket.getaddrinfo(host, None)
        return 0 <= int(number) < 2**16
    except (OSError, ValueError):
        return False


def our_settings() -> bool:
    """Whether Fast DDS has settings from us."""
    return on_loopback_alone() or _told("network")


def on_loopback_alone() -> bool:
    """Whether our settings restrict Fast DDS to the loopback device."""
    return _told("machine")


def _told(reach: str) -> bool:
    name, file = _settings(reach)
    return os.environ.get(name) == file


def _tell_fast_dds(reach: str) -> None:
    """Give Fast DDS our settings for a discovery range, unless the environment has some.

    Our settings for this machine alone replace the LOCALHOST of ROS, which adds shared memory to
    any transports. They are not used if the environment names further hosts.
    """
    told = any(os.environ.get(name) for name in (*PROFILES, TRANSPORTS))
    if told or not (os.environ.get(MIDDLEWARE) or FAST_DDS).startswith(FAST_DDS):
        return
    here = reach == "LOCALHOST" and not any(os.environ.get(name) for name in ELSEWHERE)
    if here:
        os.environ[RANGE] = "SYSTEM_DEFAULT"
    name, file = _settings("machine" if here else "network")
    os.environ[name] = file


def _forget_what_we_told() -> None:
    """Remove our settings for this machine alone, set by this process or by its parent."""
    if on_loopback_alone():
        for name in (RANGE, *PROFILES):
            os.environ.pop(name, None)


def _settings(reach: str) -> tuple[str, str]:
    """Return the variable for the settings of this Fast DDS, and our file for `reach`.

    Versions 2 and 3 have separate files, since two elements have other names in version 3. Fast DDS
    ignores a whole file that has an unknown name in it.
    """
    from ament_index_python.packages import get_package_share_directory

    three = is_fast_dds_3()
    file = f"{reach}_3.xml" if three else f"{reach}.xml"
    return PROFILES[three], str(Path(get_package_share_directory("flock_sim")) / file)


@cache
def is_fast_dds_3() -> bool:
    """Whether ROS was built with Fast DDS 3, whose package has another name than version 2's."""
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        share = get_package_share_directory("rmw_fastrtps_shared_cpp")
    except PackageNotFoundError:
        return False
    return "<build_depend>fastdds<" in (Path(share) / "package.xml").read_text(encoding="utf-8")
