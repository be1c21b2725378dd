# SPDX-License-Identifier: Apache-2.0
"""A Foxglove WebSocket server: what `view` publishes, without a bridge.

Topics, types and bytes are those of ROS 2, so that one layout serves both ways.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

import foxglove
from foxglove.websocket import Capability

from flock_sim.bag.definitions import installed_definition
from flock_sim.errors import FlockError
from flock_tools.view_messages import TRANSFORM, TRANSFORMS

BACKLOG = 8
"""Messages kept for a client that is slow; older ones are dropped."""


class FoxgloveServer:
    """Offers topics to Foxglove clients, from its making until it is closed."""

    def __init__(self, host: str, port: int, types: dict[str, str]) -> None:
        """Serve topics of the message `types`, by name, on `host` and `port`; 0 is any free port.

        Raises FlockError where these can't be had, or a type is not installed.
        """
        # Kept: with it, its channels would go.
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="flock view",
                host=host,
                port=port,
                capabilities=[Capability.Time],
                message_backlog_size=BACKLOG,
                context=self._context,
            )
        except RuntimeError as error:
            reason = str(error).rpartition("Failed to bind port: ")[2].partition(" (os error")[0]
            raise FlockError(
                f"--foxglove {port}: can't be served on {host}: {reason}; choose another port, or "
                "0 for one that is free, or another --host"
            ) from error
        self._channels = {
            topic: foxglove.Channel(
                topic,
                schema=foxglove.Schema(name=kind, encoding="ros2msg", data=_definition(kind)),
                message_encoding="cdr",
                context=self._context,
            )
            for topic, kind in types.items()
        }
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"

    def publish(self, topic: str, stamp: int, message: Callable[[], bytes]) -> None:
        """Send what `message` gives, of simulated time `stamp` in ns, to those who subscribed."""
        channel = self._channels[topic]
        if channel.has_sinks():
            channel.log(message(), log_time=stamp)

    def tell_time(self, stamp: int) -> None:
        """Tell all clients the simulated time, in ns."""
        self._server.broadcast_time(stamp)

    def close(self) -> None:
        """Send everybody away."""
        self._server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _definition(kind: str) -> bytes:
    """Return the definition of a message type; that of tf2_msgs need not be installed."""
    if kind != TRANSFORMS:
        return installed_definition(kind).text.encode()
    short = TRANSFORM.replace("/msg/", "/")
    nested = installed_definition(TRANSFORM).text
    return f"{short}[] transforms\n{'=' * 80}\nMSG: {short}\n{nested}".encode()
