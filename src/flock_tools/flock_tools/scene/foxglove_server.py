# SPDX-License-Identifier: Apache-2.0
"""A Foxglove WebSocket server for the topics of `view`, without a bridge.

Topics, types and bytes are those of ROS 2, so one layout works in both cases. Any web page that a
user opens can make the browser connect to this machine. Only the Origin that the browser sends
distinguishes it from the user's own programs. Foxglove's SDK does not expose the Origin, so this
module implements the few protocol messages that are needed.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import re
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Collection
from contextlib import suppress
from http import HTTPStatus
from threading import Thread
from typing import Any, Self

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from flock_sim.bag.definitions import copied_definition
from flock_sim.errors import FlockError
from flock_sim.outside import json_text
from flock_sim.outside.printing import shown

BACKLOG = 8
"""Number of messages kept for a slow client; older ones are dropped."""

MOST_SUBSCRIPTIONS = 1000
"""Largest number of subscriptions of a client."""

SUBPROTOCOLS = [
    Subprotocol(name) for name in ("foxglove.sdk.v1", "foxglove.sdk.v1.1", "foxglove.websocket.v1")
]
"""Names of the protocol that clients use."""

LOCAL = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?", re.ASCII)
"""The Origin of pages that this machine serves."""

MESSAGE, TIME = struct.Struct("<BIQ"), struct.Struct("<BQ")
"""Header of a message: opcode, subscription, time in ns; and a time: opcode, time in ns."""

FAREWELL = 1.0
"""Longest wait for a client to close its connection, in s."""


class FoxgloveServer:
    """Offers topics to Foxglove clients, from its creation until it is closed."""

    def __init__(
        self,
        host: str,
        port: int,
        types: dict[str, str],
        origins: Collection[str] = (),
        refused: Callable[[str], None] = lambda origin: None,
    ) -> None:
        """Serve topics of the message `types`, by name, on `host` and `port`; 0 is any free port.

        Programs, which send no Origin, may connect, as may web pages of this machine and of
        `origins`. For other pages, `refused` is called with the Origin, in another thread.

        Raises FlockError if the port is not available.
        """
        self._channels = {topic: number for number, topic in enumerate(types, start=1)}
        self._greeting = [_server_info(), _advertisement(types)]
        self._origins = frozenset(origins)
        self._refused = refused
        self._clients: set[_Client] = set()
        self._wanted: frozenset[int] = frozenset()
        listener = _listener(host, port)
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{listener.getsockname()[1]}"
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        begun = asyncio.run_coroutine_threadsafe(self._serve(listener), self._loop)
        self._server = begun.result()

    def publish(self, topic: str, stamp: int, message: Callable[[], bytes]) -> None:
        """Send the result of `message`, of simulated time `stamp` in ns, to subscribed clients."""
        channel = self._channels[topic]
        if channel in self._wanted:
            self._loop.call_soon_threadsafe(self._spread, channel, max(stamp, 0), message())

    def tell_time(self, stamp: int) -> None:
        """Send the simulated time, in ns, to all clients."""
        told = TIME.pack(2, max(stamp, 0))
        self._loop.call_soon_threadsafe(self._tell, told)

    def close(self) -> None:
        """Disconnect all clients and stop the server."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    async def _serve(self, listener: socket.socket) -> Server:
        return await serve(
            self._attend,
            sock=listener,
            process_request=self._check,
            subprotocols=SUBPROTOCOLS,
            compression=None,
            close_timeout=FAREWELL,
            logger=_silent(),
        )

    async def _end(self) -> None:
        self._server.close()
        await self._server.wait_closed()

    def _check(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return a refusal for a web page that may not connect."""
        for origin in request.headers.get_all("Origin"):
            if origin not in self._origins and not LOCAL.fullmatch(origin):
                self._refused(origin)
                return connection.respond(HTTPStatus.FORBIDDEN, "this Origin is not accepted\n")
        return None

    async def _attend(self, connection: ServerConnection) -> None:
        """Greet a client and handle its requests until it disconnects."""
        for told in self._greeting:
            await connection.send(told)
        client = _Client(connection, frozenset(self._channels.values()))
        self._clients.add(client)
        sending = asyncio.ensure_future(client.send())
        try:
            async for asked in connection:
                client.take(asked)
                self._count()
        except ConnectionClosed:
            pass
        finally:
            sending.cancel()
            self._clients.discard(client)
            self._count()

    def _count(self) -> None:
        self._wanted = frozenset(
            channel for client in self._clients for channel in client.subscriptions.values()
        )

    def _spread(self, channel: int, stamp: int, data: bytes) -> None:
        for client in self._clients:
            for subscription, wanted in client.subscriptions.items():
                if wanted == channel:
                    client.give(MESSAGE.pack(1, subscription, stamp) + data)

    def _tell(self, told: bytes) -> None:
        for client in self._clients:
            client.give(told)


class _Client:
    """A connected client of `channels`: its subscriptions, and its queue of messages."""

    def __init__(self, connection: ServerConnection, channels: Collection[int]) -> None:
        self._channels = channels
        self.subscriptions: dict[int, int] = {}
        """Channel number by subscription number."""
        self._connection = connection
        self._waiting: deque[str | bytes] = deque(maxlen=BACKLOG)
        self._news = asyncio.Event()

    def give(self, message: str | bytes) -> None:
        """Queue a message for the client. If the queue is full, the oldest message is dropped."""
        self._waiting.append(message)
        self._news.set()

    async def send(self) -> None:
        """Send queued messages until the connection is closed."""
        with suppress(ConnectionClosed):
            while await self._news.wait():
                self._news.clear()
                while self._waiting:
                    await self._connection.send(self._waiting.popleft())

    def take(self, asked: str | bytes) -> None:
        """Subscribe or unsubscribe at the client's request; answer others with an error."""
        try:
            self._do(asked)
        except ValueError as error:
            self.give(_error(f"request ignored: {error}"))
        except (LookupError, TypeError):
            self.give(_error("request ignored: its fields are not those of the protocol"))

    def _do(self, asked: str | bytes) -> None:
        """Raises ValueError, LookupError or TypeError if it is no request that is known."""
        if not isinstance(asked, str):
            raise ValueError("a binary message; this server takes JSON only")
        said = json_text.parse(asked)
        match said["op"]:
            case "subscribe":
                for wanted in said["subscriptions"]:
                    self._subscribe(_number(wanted["id"]), _number(wanted["channelId"]))
            case "unsubscribe":
                for number in said["subscriptionIds"]:
                    self.subscriptions.pop(_number(number), None)
            case other:
                raise ValueError(f"op {other!r}: must be subscribe or unsubscribe")

    def _subscribe(self, number: int, channel: int) -> None:
        if channel not in self._channels:
            raise ValueError(f"channelId {channel}: there is no such channel")
        if len(self.subscriptions) >= MOST_SUBSCRIPTIONS and number not in self.subscriptions:
            raise ValueError(f"more than {MOST_SUBSCRIPTIONS} subscriptions")
        self.subscriptions[number] = channel


def _number(value: Any) -> int:
    """Return the number of a channel or a subscription. Raises ValueError if it is invalid."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 32:
        raise ValueError(f"{value!r}: must be a whole number of 32 bits")
    return value


def _error(text: str) -> str:
    """Return a message that tells a client of an error."""
    return json.dumps({"op": "status", "level": 2, "message": shown(text)})


def _listener(host: str, port: int) -> socket.socket:
    """Return a bound socket. Raises FlockError if that fails."""
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family)
    except OSError as error:
        # The error text for an unknown name is usable; that of create_server repeats the address.
        unknown = isinstance(error, socket.gaierror) or error.errno is None
        reason = error.strerror if unknown else os.strerror(error.errno or 0)
        raise FlockError(
            f"--foxglove {port}: can't be served on {host}: {reason}; choose another port, or "
            "0 for one that is free, or another --host"
        ) from error


def _silent() -> logging.Logger:
    """Return a disabled logger, so that failed connections are not reported."""
    logger = logging.getLogger("flock.foxglove")
    logger.disabled = True
    return logger


def _server_info() -> str:
    return json.dumps(
        {
            "op": "serverInfo",
            "name": "flock view",
            "capabilities": ["time"],
            "sessionId": str(time.time_ns()),
        }
    )


def _advertisement(types: dict[str, str]) -> str:
    channels = [
        {
            "id": number,
            "topic": topic,
            "encoding": "cdr",
            "schemaName": kind,
            "schema": copied_definition(kind).text,
            "schemaEncoding": "ros2msg",
        }
        for number, (topic, kind) in enumerate(types.items(), start=1)
    ]
    return json.dumps({"op": "advertise", "channels": channels})
