# SPDX-License-Identifier: Apache-2.0
"""A bird as a ROS 2 node."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, TypeVar

from rclpy.context import Context
from rclpy.publisher import Publisher

from flock_interfaces.msg import BirdMemory, BirdStage, BirdState, BirdWing, Progress
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.rejection import MALFORMED
from flock_sim.nodes.own_birds import announce, own_name
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.session import Channel, Outgoing
from flock_sim.ros.compiled_exchange import (
    FAILED,
    FAULTY,
    OVER,
    STRANGE,
    UNSENT,
    CompiledExchange,
    compiled_exchange_of,
    strange,
)
from flock_sim.ros.endpoints import DrainedNode, Inlet, latched
from flock_sim.ros.fetch import let_fetch
from flock_sim.ros.process import new_incarnation
from flock_sim.ros.rejection_warnings import RejectionWarnings

if TYPE_CHECKING:
    from flock_sim.protocol.free_bird import FreeBird

LOOK_EVERY = 1.0
"""Time between looks at a wing in flight, in s. No bird sends one then, but others may, and their
messages must not fill the queue."""

FETCHED = (Channel.STATE, Channel.MEMORY, Channel.AGES)
"""Channels for the recorder and other listeners. No bird waits for their messages."""

Heard = TypeVar("Heard", bound=messages.Message)


class BirdNode(DrainedNode):
    """A bird node. It only moves messages between its protocol and its topics."""

    def __init__(
        self,
        bird: int,
        configuration: FlockConfiguration,
        run_id: int = 0,
        *,
        context: Context | None = None,
        services: bool = False,
        first: BirdNode | None = None,
        protocol: BirdProtocol | FreeBird | None = None,
        outlets: Mapping[Channel, tuple[type, str]] | None = None,
    ) -> None:
        """Put bird 1..N on its topics; `services`: with rosout and the parameter services.

        `first` is the first bird of its process, if there are several: they share the publisher of
        reports, and the rejection warnings. Without `protocol` and its `outlets`, the bird flies in
        lockstep.
        """
        super().__init__(
            topics.bird_name(bird),
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=services,
            enable_rosout=first is None,
        )
        self.protocol = protocol or BirdProtocol(bird, configuration, run_id, new_incarnation())
        """The state machine of this bird."""
        if own := own_name(self, self.protocol):
            announce(self, own)
        self._exchange: CompiledExchange | None = None
        outlets = outlets or _outlets(bird, configuration)
        fetched = [topic for channel, (_, topic) in outlets.items() if channel in FETCHED]
        let_fetch(map(self.own_topic, fetched), topics.fetch_period(configuration))
        self._outlets = {
            channel: self.create_publisher(kind, topic, latched(topics.depth(topic, configuration)))
            for channel, (kind, topic) in outlets.items()
        }
        if first is None:
            # One publisher sends the reports of all birds of a process to the clock.
            depth = topics.depth(topics.PROGRESS_TOPIC, configuration)
            self.reports = self.create_publisher(Progress, topics.PROGRESS_TOPIC, latched(depth))
            self._outlets[Channel.PROGRESS] = self.reports
            self.told: set[str] = set()
        else:
            self.reports, self.told = first.reports, first.told
        self._publish: dict[Channel, Callable[[bytes], None]] = {
            channel: outlet.handle.publish_raw for channel, outlet in self._outlets.items()
        }
        self._publish[Channel.PROGRESS] = self.reports.handle.publish_raw
        self._wings = {
            other: self.subscribe_drained(BirdWing, topics.wing_topic(other))
            for other in self.protocol.neighbours
        }
        self._stages = {
            other: self.subscribe_drained(BirdStage, topics.stage_topic(other))
            for other in self.protocol.neighbours
        }
        self._next_wing = itertools.cycle(self._wings.values())
        self._look_at = 0.0  # monotonic time of the next look at a wing in flight, in s
        self._take_raw = {other: inlet.take_raw for other, inlet in self._stages.items()}
        self._rejection_warnings = RejectionWarnings(
            self, self.protocol.ignored_for, self.told, logger=first or self
        )
        if isinstance(self.protocol, BirdProtocol):
            inlets = [inlet.subscription for inlet in self._stages.values()]
            outlet = self._outlets[Channel.STAGE]
            self._exchange = compiled_exchange_of(self.protocol, configuration.dt, outlet, inlets)

    def drain(self) -> bool:
        """Take the stages that it waits for, and continue; return whether any came."""
        if self._exchange and self._lockstep.on_fast_path:
            return self._after(self._exchange.go_on)
        return self._take_missing()

    def drain_rare(self) -> bool:
        """Take all other messages: stages not waited for, and wings."""
        if self._exchange and self._lockstep.on_fast_path:
            moved = self._after(self._exchange.look_through)
        else:
            moved = self._take_all_stages()
        if self._exchange:
            self._lockstep.count_foreign()
        for inlet in self._wings_due():
            while (data := inlet.take()) is not None:
                moved |= self.hear(messages.Wing, self.protocol.receive_wing, data)
        self._rejection_warnings.tell()
        return moved

    def _wings_due(self) -> Iterable[Inlet]:
        """Return the wings to look at now: all before the flight, and then one at a time."""
        if not self.protocol.in_flight:
            return self._wings.values()
        now = time.monotonic()
        if now < self._look_at or not self._wings:
            return ()
        self._look_at = now + LOOK_EVERY
        return (next(self._next_wing),)

    def report(self) -> None:
        """Report to the clock that this bird is present and waits."""
        self._send(self.protocol.report())

    @property
    def finished(self) -> bool:
        """Whether the flight is over for this bird."""
        return self.protocol.finished and self.protocol.released

    @property
    def waiting_for(self) -> str:
        """What the bird needs to continue, as text."""
        return f"{self.get_name()} waits for {self.protocol.waiting_for}"

    @property
    def outlets(self) -> Iterable[Publisher]:
        """The publishers of this bird."""
        return self._outlets.values()

    def destroy_node(self) -> None:
        """Destroy this node, and first its fast path, which uses addresses of its endpoints."""
        self._exchange = None
        super().destroy_node()

    def hear(
        self, kind: type[Heard], receive: Callable[[Heard], list[Outgoing]], data: bytes
    ) -> bool:
        """Pass a message to `receive` of the protocol, and send the messages that it returns.

        Returns whether the protocol accepted the message.
        """
        ignored = self.protocol.ignored
        try:
            message = kind.decode(data)
        except ValueError:
            self.protocol.ignore(MALFORMED)
        else:
            self._send(receive(message))
        return self.protocol.ignored == ignored

    @property
    def _lockstep(self) -> BirdProtocol:
        """The protocol of a bird with a compiled exchange, which flies in lockstep."""
        assert isinstance(self.protocol, BirdProtocol)
        return self.protocol

    def _after(self, exchange: Callable[[], int]) -> bool:
        """Exchange stages, and do what they need beyond that; return whether anything came."""
        protocol = self._lockstep
        before, accepted = protocol.tick, False
        while (outcome := exchange()) == STRANGE:
            accepted |= self._take_stage(strange())
        moved = accepted or protocol.tick > before
        if outcome == OVER:
            self._send(protocol.advance())
        elif outcome == FAILED:
            moved |= self._take_missing()
        elif outcome == FAULTY:
            protocol.check()
        elif outcome == UNSENT:
            self._send(protocol.last_said[-1:])
        return moved

    def _take_missing(self) -> bool:
        """Take the stages that the protocol waits for; return whether any came.

        If it waits for none, take all stages: a queue full of another flight's messages would
        reject those of our neighbours.
        """
        protocol = self.protocol
        missing = protocol.missing
        if not missing:
            return self._take_all_stages()
        moved = False
        for other in missing:
            take = self._take_raw[other]
            while (taken := take()) is not None:
                ignored = protocol.ignored
                if outgoing := protocol.receive_stage(taken[0]):
                    self._send(outgoing)
                if protocol.ignored == ignored:
                    moved = True
                    break
        return moved

    def _take_all_stages(self) -> bool:
        moved = False
        for inlet in self._stages.values():
            while (data := inlet.take()) is not None:
                moved |= self._take_stage(data)
        return moved

    def _take_stage(self, data: bytes) -> bool:
        """Pass a stage to the protocol; return whether the protocol accepted it."""
        protocol = self.protocol
        ignored = protocol.ignored
        self._send(protocol.receive_stage(data))
        return protocol.ignored == ignored

    def _send(self, outgoing: list[Outgoing]) -> None:
        for channel, data in outgoing:
            self._publish[channel](data)


def _outlets(bird: int, configuration: FlockConfiguration) -> dict[Channel, tuple[type, str]]:
    """Return the type and the topic of each channel in lockstep, except reports."""
    outlets = {
        Channel.WING: (BirdWing, topics.wing_topic(bird)),
        Channel.STAGE: (BirdStage, topics.stage_topic(bird)),
        Channel.STATE: (BirdState, topics.state_topic(bird)),
    }
    if configuration.link_table.remembers(bird):
        outlets[Channel.MEMORY] = (BirdMemory, topics.memory_topic(bird))
    return outlets
