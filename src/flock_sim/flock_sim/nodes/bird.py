# SPDX-License-Identifier: Apache-2.0
"""A bird as a ROS 2 node, and the process of one bird or of several."""

from __future__ import annotations

import gc
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.publisher import Publisher

from flock_interfaces.msg import BirdMemory, BirdStage, BirdState, BirdWing, Progress
from flock_sim.core import messages, topics
from flock_sim.core.bird_step import StageKernel, feel_and_move
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.free_flight import check_free
from flock_sim.core.protocol import BirdProtocol, Channel, Outgoing
from flock_sim.core.stage_inbox import MALFORMED
from flock_sim.core.steering import Control
from flock_sim.errors import FlockError
from flock_sim.nodes.announcements import Announcements
from flock_sim.nodes.complaints import Complaints
from flock_sim.nodes.diagnostics import Diagnostics, Status, ignored
from flock_sim.nodes.drain import keep_flying
from flock_sim.nodes.endpoints import DrainedNode, latched, wait_until_heard
from flock_sim.nodes.exchange import FAILED, MOVED, STRANGE, Legs, legs_of, strange
from flock_sim.nodes.parameters import OF_ALL, declare
from flock_sim.nodes.patience import Patience
from flock_sim.nodes.process import Process, executing, new_life, run_node
from flock_sim.nodes.stopwatch import Stopwatch
from flock_sim.stop import Stop

if TYPE_CHECKING:
    from flock_sim.core.free_bird import FreeBird

REPORTS = latched(1000)
"""How reports to the clock are sent: those of all birds of a process by one publisher."""

FAREWELL = 1.0
"""Longest wait, in s, for whoever else listens; the flock itself needs released birds no more."""

Heard = TypeVar("Heard", bound=messages.Message)

Keep = Callable[..., None]
"""What `keep_flying` is, and whatever flies birds by the same arguments."""


class BirdNode(DrainedNode):
    """A bird: moves messages between its protocol and its topics, and nothing else."""

    control: Control | None = None
    """A force besides those that all birds feel: a method of subclasses that have one."""

    def __init__(
        self,
        bird: int,
        configuration: FlockConfiguration,
        run_id: int = 0,
        *,
        context: Context | None = None,
        services: bool = False,
        first: BirdNode | None = None,
        stage_kernel: StageKernel | None = None,
        protocol: BirdProtocol | FreeBird | None = None,
        outlets: Mapping[Channel, tuple[type, str]] | None = None,
    ) -> None:
        """Put bird 1..N on its topics; `services`: with rosout and those for parameters.

        `first` is that of its process, if there are others: they report and complain together.
        `stage_kernel` is for the protocol.
        `protocol` and the `outlets` that go with it are those of lockstep if not given.
        """
        super().__init__(
            topics.bird_name(bird),
            namespace=topics.NAMESPACE,
            context=context,
            start_parameter_services=services,
            enable_rosout=services,
        )
        self._protocol = protocol or BirdProtocol(
            bird, configuration, run_id, new_life(), self.control, stage_kernel
        )
        self._legs: Legs | None = None
        self._outlets = {
            channel: self.create_publisher(kind, topic, latched(topics.depth(topic, configuration)))
            for channel, (kind, topic) in (outlets or _outlets(bird, configuration)).items()
        }
        if first is None:
            self.reports = self.create_publisher(Progress, topics.PROGRESS_TOPIC, REPORTS)
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
        self._take_raw = {other: inlet.take_raw for other, inlet in self._stages.items()}
        self._complaints = Complaints(self.get_name(), self.protocol.ignored_for, self.told)
        if isinstance(self._protocol, BirdProtocol):
            inlets = [inlet.subscription for inlet in self._stages.values()]
            outlet = self._outlets[Channel.STAGE]
            self._legs = legs_of(self._protocol, configuration.dt, outlet, inlets)

    @property
    def protocol(self) -> BirdProtocol | FreeBird:
        """What it says when. Where it is on a leg, it lands to be asked."""
        if self._legs and self._legs.on:
            self._send(self._legs.land())
        return self._protocol

    def drain(self) -> bool:
        """Take the stages that it waits for, and go on; return whether it could."""
        legs = self._legs
        if legs is None or not legs.embark():
            return self._take_missing()
        return self._after(legs.go_on())

    def drain_rare(self) -> bool:
        """Take all else: stages of whom it waits for no more, wings before the flight."""
        legs = self._legs
        if legs and legs.on:
            moved = self._after(legs.look_through())
            if legs.foreign and legs.on:
                self._send(legs.land())
        else:
            moved = self._take_all_stages()
        if not self._protocol.in_flight:
            for inlet in self._wings.values():
                while (data := inlet.take()) is not None:
                    moved |= self.hear(messages.Wing, self._protocol.receive_wing, data)
        self._complaints.tell()
        return moved

    def report(self) -> None:
        """Tell the clock that this bird is there, and waits."""
        self._send(self.protocol.report())

    @property
    def finished(self) -> bool:
        """Whether the flight is over for this bird."""
        if self._legs and self._legs.on:
            return False
        return self.protocol.finished and self.protocol.released

    @property
    def waiting_for(self) -> str:
        """What the bird needs to go on, in words."""
        return f"{self.get_name()} waits for {self.protocol.waiting_for}"

    @property
    def outlets(self) -> Iterable[Publisher]:
        """All that it says something on."""
        return self._outlets.values()

    def destroy_node(self) -> None:
        """Be no more; legs go by the addresses of what goes with it."""
        self._legs = None
        super().destroy_node()

    def hear(
        self, kind: type[Heard], receive: Callable[[Heard], list[Outgoing]], data: bytes
    ) -> bool:
        """Let its protocol `receive` a message, and send what that answers.

        Returns whether it was one for this bird.
        """
        ignored = self.protocol.ignored
        try:
            message = kind.decode(data)
        except ValueError:
            self.protocol.ignore(MALFORMED)
        else:
            self._send(receive(message))
        return self.protocol.ignored == ignored

    def _after(self, outcome: int) -> bool:
        """Land where a leg is over, or can't go on by itself; return whether anything came."""
        if outcome <= MOVED:
            return outcome == MOVED
        legs = self._legs
        assert legs is not None
        moved = legs.moved
        data = strange() if outcome == STRANGE else b""
        self._send(legs.land())
        if outcome == STRANGE:
            moved |= self._take_stage(data)
        elif outcome == FAILED:
            moved |= self._take_missing()
        return moved

    def _take_missing(self) -> bool:
        """Take the stages that the protocol waits for; return whether any came.

        Where it waits for none, whatever is there: a queue that is full of another flight's would
        turn away our neighbours'.
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
        """Let its protocol receive a stage; return whether it was one for this bird."""
        protocol = self.protocol
        ignored = protocol.ignored
        self._send(protocol.receive_stage(data))
        return protocol.ignored == ignored

    def _send(self, outgoing: list[Outgoing]) -> None:
        for channel, data in outgoing:
            self._publish[channel](data)


def _outlets(bird: int, configuration: FlockConfiguration) -> dict[Channel, tuple[type, str]]:
    """Return what a bird says where in lockstep, reports apart."""
    outlets = {
        Channel.WING: (BirdWing, topics.wing_topic(bird)),
        Channel.STAGE: (BirdStage, topics.stage_topic(bird)),
        Channel.STATE: (BirdState, topics.state_topic(bird)),
    }
    if configuration.linkage.remembers(bird):
        outlets[Channel.MEMORY] = (BirdMemory, topics.memory_topic(bird))
    return outlets


def work(process: Process) -> None:
    """Fly the birds that the parameters name, in lockstep or freely."""
    configuration, operation = process.configuration, process.operation
    indices = operation["indices"] or [operation["index"]]
    for index in indices:
        if not 1 <= index <= configuration.birds:
            raise FlockError(
                f"index = {index}: must be 1..{configuration.birds}; give it as -p index:=1"
            )
    watch = Stopwatch() if operation["stopwatch"] else None
    with executing(operation["executor"], process.context) as executor:
        alone = len(indices) == 1
        kind, keep = _free(process) if operation["real_time_factor"] else _lockstep(watch)
        birds = hatch(
            indices, configuration, operation["run_id"], executor, kind=kind, services=alone
        )
        if alone:
            operation = {**operation, "index": indices[0]}
            declare(birds[0], configuration, operation, ("index", *OF_ALL))
        process.settle()
        gc.freeze()  # what is here stays: no need to look through it again and again
        fly_together(birds, executor, process.stop, process.patience(), keep)
        if watch:
            watch.times.write(Path(operation["stopwatch"]))
        wait_until_heard((o for bird in birds for o in bird.outlets), process.stop, FAREWELL)


def _lockstep(watch: Stopwatch | None) -> tuple[Callable[..., BirdNode], Keep]:
    """Return how birds that wait for each other are made, and flown; `watch` takes the time."""
    if watch is None:
        return BirdNode, keep_flying
    return partial(BirdNode, stage_kernel=watch.around(feel_and_move)), watch.keep_flying


def _free(process: Process) -> tuple[Callable[..., BirdNode], Keep]:
    """Return how birds that fly freely are made, and flown."""
    # Imported here, since they are made of the birds above.
    from flock_sim.nodes.free_bird import FreeBirdNode, keep_ticking

    operation = process.operation
    factor = operation["real_time_factor"]
    check_free(process.configuration, factor, operation["timeout"], operation["record_stages"])
    return partial(FreeBirdNode, factor=factor), keep_ticking


def hatch(
    indices: Iterable[int],
    configuration: FlockConfiguration,
    run_id: int,
    executor: Executor,
    *,
    kind: Callable[..., BirdNode] = BirdNode,
    services: bool = False,
) -> list[BirdNode]:
    """Return the birds `indices` of one process, nodes of a `kind` that `executor` serves."""
    birds: list[BirdNode] = []
    for index in indices:
        first = birds[0] if birds else None
        bird = kind(
            index, configuration, run_id, context=executor.context, services=services, first=first
        )
        executor.add_node(bird)
        birds.append(bird)
    return birds


def fly_together(
    birds: Sequence[BirdNode],
    executor: Executor,
    stop: Stop,
    patience: Patience,
    keep: Keep = keep_flying,
) -> None:
    """Fly the birds of one process to the end, or until `stop`; `keep` does as `keep_flying`.

    Raises RunFailed when `patience` runs out.
    """
    announcements, diagnostics = Announcements(birds), Diagnostics(birds[0])

    def look_around() -> bool:
        diagnostics.tell(lambda: status(birds))
        return announcements.drain()

    keep(birds, executor, stop, patience, look_around)


def status(birds: Sequence[BirdNode]) -> Status:
    """Return what the process of `birds` tells of itself."""
    protocols = [bird.protocol for bird in birds]
    last = min(birds, key=lambda bird: bird.protocol.step)
    waiting = [bird.waiting_for for bird in birds if not bird.protocol.in_flight]
    counts = sum((protocol.ignored_for for protocol in protocols), Counter[str]())
    return (
        not waiting,
        waiting[0] if waiting else "flying",
        {
            "birds": ", ".join(str(protocol.bird) for protocol in protocols),
            "step": last.protocol.step,
            "furthest behind": last.waiting_for,
            **ignored(counts),
        },
    )


_main = run_node(
    "bird",
    "One bird as a ROS 2 node. It flies as soon as its neighbours and the clock are there.\n\n"
    "parameters: index (1..N), run_id, timeout (s without news), executor (events|single),\n"
    "real_time_factor (to all nodes: fly freely, so much faster than real time), and all keys of\n"
    "the configuration file.",
    "  ./flock bird --ros-args -p index:=3 --params-file flock.yaml\n"
    "  ros2 run flock_sim bird --ros-args -p index:=1 -p birds:=3 -p t_max:=100.0",
    work,
)


def main() -> int:
    """Run the `bird` executable."""
    return _main(None)


if __name__ == "__main__":
    sys.exit(main())
