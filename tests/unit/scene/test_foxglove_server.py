# SPDX-License-Identifier: Apache-2.0
"""The Foxglove server serves programs and trusted pages, and refuses all other pages."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from flock_tools.commands.view import MOST_REFUSALS, _refusals
from flock_tools.scene.foxglove_server import MOST_SUBSCRIPTIONS, FoxgloveServer

TYPES = {"/words": "sensor_msgs/msg/Image", "/tf": "tf2_msgs/msg/TFMessage"}
APP = "https://app.foxglove.dev"
PROTOCOL = Subprotocol("foxglove.sdk.v1")


class Served:
    """A server, what it refused, and clients of it."""

    def __init__(self, server: FoxgloveServer, refused: list[str]) -> None:
        self.server = server
        self.refused = refused

    @contextmanager
    def client(self, origin: str | None = None) -> Iterator[ClientConnection]:
        sent = None if origin is None else Origin(origin)
        with connect(self.server.address, origin=sent, subprotocols=[PROTOCOL]) as connection:
            yield connection


@pytest.fixture
def served() -> Iterator[Served]:
    refused: list[str] = []
    with FoxgloveServer("127.0.0.1", 0, TYPES, [APP], refused.append) as server:
        yield Served(server, refused)


@pytest.mark.parametrize(
    "origin",
    [
        *(None, APP, "http://localhost", "http://localhost:8080", "https://localhost:1"),
        *("http://127.0.0.1:3000", "http://[::1]:3000"),
    ],
)
def test_programs_and_trusted_pages_are_served(served: Served, origin: str | None) -> None:
    with served.client(origin) as connection:
        assert connection.subprotocol == PROTOCOL
        assert json.loads(connection.recv())["op"] == "serverInfo"
    assert served.refused == []


@pytest.mark.parametrize(
    "origin",
    [
        *("https://evil.example", "http://localhost.evil.example", "http://evil.example:8765"),
        *("null", "file://", "http://localhost@evil.example", "ftp://localhost", "localhost"),
        *(f"{APP}.evil.example", "http://127.0.0.1.evil.example", "http://localhost:80.evil", ""),
    ],
)
def test_other_pages_are_refused(served: Served, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"), served.client(origin):
        pass
    assert served.refused == [origin]


def test_one_trusted_origin_beside_another_is_not_enough(served: Served) -> None:
    two = {"Origin": "https://evil.example"}
    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(served.server.address, origin=Origin(APP), additional_headers=two),
    ):
        pass


@pytest.mark.parametrize("protocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_clients_of_both_protocols_are_served(served: Served, protocol: str) -> None:
    offered = [Subprotocol("another"), Subprotocol(protocol)]
    with connect(served.server.address, subprotocols=offered) as connection:
        assert connection.subprotocol == protocol
        assert json.loads(connection.recv())["op"] == "serverInfo"
        (tf,) = (
            each for each in json.loads(connection.recv())["channels"] if each["topic"] == "/tf"
        )
        assert (tf["schemaName"], tf["schemaEncoding"]) == ("tf2_msgs/msg/TFMessage", "ros2msg")
        assert tf["schema"].startswith("geometry_msgs/TransformStamped[] transforms\n")


def until_told(connection: ClientConnection) -> bytes:
    """Return the next message that is no text."""
    while isinstance(data := connection.recv(timeout=60), str):
        pass
    return bytes(data)


def test_clients_hear_what_they_have_subscribed_to(served: Served) -> None:
    def ask(connection: ClientConnection, op: str, **what: object) -> None:
        connection.send(json.dumps({"op": op, **what}))

    with served.client() as one, served.client() as other:
        assert json.loads(one.recv())["capabilities"] == ["time"]
        channels = {each["topic"]: each["id"] for each in json.loads(one.recv())["channels"]}
        assert channels.keys() == TYPES.keys()
        for nonsense in ("[", b"\x01", "7", '{"op": 1}', '{"op": "subscribe"}', 9999 * "["):
            one.send(nonsense)
        wrong = [{"id": -1, "channelId": 1}, {"id": "1", "channelId": 1}]
        ask(one, "subscribe", subscriptions=wrong)
        ask(one, "subscribe", subscriptions=[{"id": 7, "channelId": channels["/words"]}])
        ask(other, "subscribe", subscriptions=[{"id": 8, "channelId": channels["/words"]}])
        heard: dict[int, tuple[int, bytes]] = {}
        stamps = count(5)
        while len(heard) < 2:  # each is asked for in its own time
            served.server.publish("/words", next(stamps), lambda: b"abc")
            for connection in (one, other):
                try:
                    data = connection.recv(timeout=0.01)
                except TimeoutError:
                    continue
                if isinstance(data, bytes) and data[0] == 1:
                    _, subscription, stamp = struct.unpack_from("<BIQ", data)
                    heard[subscription] = (stamp, data[13:])
        assert {data for _, data in heard.values()} == {b"abc"}
        assert heard.keys() == {7, 8}
        served.server.publish("/tf", 1, lambda: pytest.fail("nobody wants it"))
        served.server.tell_time(-3)  # a forged stamp
        while until_told(one) != struct.pack("<BQ", 2, 0):
            pass
        ask(one, "unsubscribe", subscriptionIds=[7])


HOSTILE = {
    "nested deep": 100_000 * "[",
    "objects nested deep": 100_000 * '{"op":',
    "a long number": f'{{"op": "subscribe", "subscriptions": [{9000 * "9"}]}}',
    "not JSON": "subscribe",
    "no object": "7",
    "no operation": "{}",
    "an operation that is no text": '{"op": {"subscribe": []}}',
    "an unknown operation": '{"op": "advertise\\u001b[2J", "channels": []}',
    "no list": '{"op": "subscribe", "subscriptions": 5}',
    "a negative id": '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
    "a Boolean id": '{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}]}',
    "no such channel": '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
    "infinite": '{"op": "unsubscribe", "subscriptionIds": [1e999]}',
    "binary": b"\x01\0\0\0\0",
    "empty": "",
    "a surrogate": '{"op": "\\ud800"}',
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_request_is_answered_by_one_error_and_others_are_served(
    served: Served, name: str
) -> None:
    with served.client() as hostile, served.client() as other:
        for connection in (hostile, other):
            connection.recv()
            connection.recv()
        hostile.send(HOSTILE[name])
        answer = json.loads(hostile.recv(timeout=60))
        assert (answer["op"], answer["level"]) == ("status", 2)
        assert answer["message"].startswith("request ignored: ")
        assert answer["message"].isprintable()
        assert len(answer["message"]) < 100
        for connection in (hostile, other):  # both are still connected
            connection.send('{"op": "subscribe", "subscriptions": [{"id": 5, "channelId": 1}]}')
        served.server.tell_time(9)
        for connection in (hostile, other):
            assert until_told(connection) == struct.pack("<BQ", 2, 9)


def test_a_client_with_many_subscriptions_gets_no_more(served: Served) -> None:
    with served.client() as connection:
        connection.recv()
        connection.recv()
        many = [{"id": number, "channelId": 1} for number in range(MOST_SUBSCRIPTIONS + 1)]
        connection.send(json.dumps({"op": "subscribe", "subscriptions": many}))
        assert "more than 1000 subscriptions" in json.loads(connection.recv(timeout=60))["message"]
        (client,) = served.server._clients
        assert len(client.subscriptions) == MOST_SUBSCRIPTIONS


def test_a_huge_request_ends_its_connection_only(served: Served) -> None:
    with served.client() as hostile, served.client() as other:
        for connection in (hostile, other):
            connection.recv()
            connection.recv()
        hostile.send(f'{{"op": "{2**21 * "x"}"}}')
        with pytest.raises(ConnectionClosed):
            hostile.recv(timeout=60)
        served.server.tell_time(9)
        assert until_told(other) == struct.pack("<BQ", 2, 9)


def test_a_page_that_was_refused_is_told_of_once(capsys: pytest.CaptureFixture[str]) -> None:
    refused = _refusals()
    for _ in range(3):
        refused("https://evil.example/\x1b[2J")
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "refused a web page from https://evil.example/\\x1b[2J" in told
    for number in range(2 * MOST_REFUSALS):
        refused(f"https://{number}.example")
    assert capsys.readouterr().err.count("\n") == MOST_REFUSALS - 1
