# SPDX-License-Identifier: Apache-2.0
"""The process of one or several birds: it creates their nodes and flies them."""

from __future__ import annotations

import gc
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from rclpy.executors import Executor

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.operation import declared_by
from flock_sim.console.signals import Stop
from flock_sim.errors import FlockError
from flock_sim.nodes.announcements import Announcements
from flock_sim.nodes.bird import BirdNode
from flock_sim.nodes.free_bird import FreeBirdNode, keep_ticking
from flock_sim.protocol.free_flight import check_free
from flock_sim.ros.diagnostics import Diagnostics, Status, ignored
from flock_sim.ros.endpoints import wait_until_heard
from flock_sim.ros.parameters.declared import declare
from flock_sim.ros.parameters.late_services import LateParameters
from flock_sim.ros.process import Process, executing, run_node
from flock_sim.ros.spin import keep_flying
from flock_sim.ros.watchdog import Watchdog

FAREWELL = 1.0
"""Longest wait for other listeners, in s. The flock itself does not need released birds."""

Keep = Callable[..., None]
"""Type of `keep_flying`, and of functions with the same arguments."""


def work(process: Process) -> None:
    """Fly the birds that the parameters name, in lockstep or freely."""
    configuration, operation = process.configuration, process.operation
    indices = operation["indices"] or [operation["index"]]
    for index in indices:
        if not 1 <= index <= configuration.birds:
            raise FlockError(
                f"index = {index}: must be 1..{configuration.birds}; give it as -p index:=1"
            )
    with executing(operation["executor"], process.context) as executor:
        by_hand = len(indices) == 1 and not process.supervised
        free = bool(operation["real_time_factor"])
        kind, keep = _free(process) if free else (BirdNode, keep_flying)
        birds = create_birds(
            indices, configuration, operation["run_id"], executor, kind=kind, services=by_hand
        )

        def declare_parameters(bird: BirdNode) -> None:
            own = {**operation, "index": bird.protocol.bird}
            declare(bird, configuration, own, declared_by("bird"))

        if by_hand:
            declare_parameters(birds[0])
        late = LateParameters([] if by_hand else birds, declare_parameters)
        process.settle()
        gc.freeze()  # these objects stay, so the collector need not scan them
        fly_together(birds, executor, process.stop, process.watchdog(birds[0]), keep, late)
        wait_until_heard((o for bird in birds for o in bird.outlets), process.stop, FAREWELL)


def _free(process: Process) -> tuple[Callable[..., BirdNode], Keep]:
    """Return the factory of birds in free flight and the function that flies them."""
    operation = process.operation
    factor = operation["real_time_factor"]
    check_free(process.configuration, factor, operation["timeout"], operation["record_stages"])
    return partial(FreeBirdNode, factor=factor), keep_ticking


def create_birds(
    indices: Iterable[int],
    configuration: FlockConfiguration,
    run_id: int,
    executor: Executor,
    *,
    kind: Callable[..., BirdNode] = BirdNode,
    services: bool = False,
) -> list[BirdNode]:
    """Return the birds `indices` of one process, as nodes of `kind` served by `executor`."""
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
    watchdog: Watchdog,
    keep: Keep = keep_flying,
    late_parameters: LateParameters | None = None,
) -> None:
    """Fly the birds of one process by `keep` to the end, or until `stop`.

    `late_parameters` creates their parameter services in flight. Raises RunFailed when `watchdog`
    runs out.
    """
    announcements, diagnostics = Announcements(birds), Diagnostics(birds[0])
    log = birds[0].get_logger()
    names = _names(birds)
    log.info(f"{names} waits for the flight to begin")
    in_flight = False

    def look_around() -> bool:
        nonlocal in_flight
        if not in_flight and all(bird.protocol.in_flight for bird in birds):
            in_flight = True
            log.info(f"{names} is in flight")
            if late_parameters:
                late_parameters.begin()
        if late_parameters:
            late_parameters.create_next()
        diagnostics.tell(lambda: status(birds))
        return announcements.drain()

    keep(birds, executor, stop, watchdog, look_around)
    step = min(bird.protocol.step for bird in birds)
    log.info(f"{names} {'was interrupted' if stop else 'has ended its flight'} at step {step}")


def _names(birds: Sequence[BirdNode]) -> str:
    """Return the name of one bird, or of the first and the last."""
    names = [bird.get_name() for bird in (birds[0], birds[-1])]
    return names[0] if len(birds) == 1 else "..".join(names)


def status(birds: Sequence[BirdNode]) -> Status:
    """Return the diagnostics of the process of `birds`."""
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
    "Run one bird of a flock as a ROS 2 node. It begins to fly when its neighbours and the clock\n"
    "are present.",
    "  ./flock bird --ros-args -p index:=3 --params-file flock.yaml\n"
    "  ros2 run flock_sim bird --ros-args -p index:=1 -p birds:=3 -p t_max:=100.0",
    work,
)


def main() -> int:
    """Run the `bird` executable."""
    return _main(None)


if __name__ == "__main__":
    sys.exit(main())
