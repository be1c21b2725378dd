# SPDX-License-Identifier: Apache-2.0
import os
import socket
from collections.abc import Iterator

import pytest

from flock_sim.errors import FlockError
from flock_sim.ros import settings_check
from flock_sim.ros.discovery import (
    ELSEWHERE,
    FIRST_PORT,
    LOCALHOST_ONLY,
    PORTS,
    PROFILES,
    RANGE,
    TRANSPORTS,
    prepare_discovery,
)
from flock_sim.ros.settings_check import check_settings, udp_sockets

DOMAIN = 77


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment that says nothing."""
    for name in ("RMW_IMPLEMENTATION", RANGE, LOCALHOST_ONLY, TRANSPORTS, *PROFILES, *ELSEWHERE):
        monkeypatch.setenv(name, "")


@pytest.fixture
def talk() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as talk:
        yield talk


def bind(talk: socket.socket, address: str) -> int:
    """Have a port of the domain; one that Fast DDS would come to last. Return it."""
    port = FIRST_PORT + PORTS * DOMAIN + PORTS - 1
    while True:
        try:
            talk.bind((address, port))
        except OSError:  # somebody else's
            port -= 1
        else:
            return port


def test_a_socket_that_others_can_reach_is_refused_and_named(talk: socket.socket) -> None:
    bind(talk, "0.0.0.0")
    prepare_discovery()
    with pytest.raises(FlockError, match=r"listens on 0\.0\.0\.0, .*/machine(_3)?\.xml"):
        check_settings(DOMAIN)


def test_a_socket_on_loopback_is_not(talk: socket.socket) -> None:
    port = bind(talk, "127.0.0.1")
    assert ("127.0.0.1", port) in udp_sockets()
    assert ("127.0.0.1", port) in udp_sockets(os.getpid())
    prepare_discovery()
    check_settings(DOMAIN)


def test_a_socket_of_another_domain_or_on_a_network_that_was_asked_for_is_not(
    talk: socket.socket,
) -> None:
    bind(talk, "0.0.0.0")
    prepare_discovery()
    check_settings(DOMAIN - 1)
    check_settings(DOMAIN + 1)
    prepare_discovery(network=True)
    check_settings(DOMAIN)


def test_a_process_that_has_ended_has_none() -> None:
    assert udp_sockets(2**22 + 1) == set()  # more than there can be
    assert settings_check.shared_memory(2**22 + 1) == set()


@pytest.mark.parametrize(
    ("name", "said", "refused"),
    [(RANGE, "", True), (TRANSPORTS, "SHM", False), ("ROS_STATIC_PEERS", "10.0.0.1", True)],
)
def test_over_a_network_shared_memory_tells_that_the_settings_were_not_taken(
    monkeypatch: pytest.MonkeyPatch, name: str, said: str, refused: bool
) -> None:
    monkeypatch.setattr(settings_check, "shared_memory", lambda: {"/dev/shm/fastrtps_1"})
    monkeypatch.setenv(name, said)
    prepare_discovery(network=True)
    if refused:
        with pytest.raises(FlockError, match=r"uses shared memory: .*/network(_3)?\.xml"):
            check_settings(DOMAIN)
    else:
        check_settings(DOMAIN)


def test_named_hosts_are_looked_for_as_ros_does_with_shared_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(settings_check, "shared_memory", lambda: {"/dev/shm/fastrtps_1"})
    monkeypatch.setenv("ROS_STATIC_PEERS", "10.0.0.1")
    prepare_discovery()
    check_settings(DOMAIN)
