# SPDX-License-Identifier: Apache-2.0
"""Whole flights over ROS 2 within one process, for tests and experiments of your own."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.context import Context

from flock_sim.configuration.choices import EXECUTORS
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import note, positive_number
from flock_sim.console.signals import Stop
from flock_sim.errors import RunFailed
from flock_sim.launcher.flight import JOIN_LIMIT, NODE_MARGIN, WINDOW
from flock_sim.launcher.precompile import warm_links
from flock_sim.messages import topics
from flock_sim.nodes.bird import BirdNode
from flock_sim.nodes.bird_process import create_birds, fly_together
from flock_sim.nodes.clock import ClockNode, keep_time
from flock_sim.nodes.recorder import RecorderNode, record
from flock_sim.protocol.clock import Timekeeper, new_run_id
from flock_sim.recording.flight_writer import Recording, recording
from flock_sim.recording.output_directory import own_output
from flock_sim.ros.discovery import (
    DOMAIN,
    ELSEWHERE,
    LOCALHOST_ONLY,
    PROFILES,
    RANGE,
    held_domain,
    prepare_discovery,
    quiet_domains,
)
from flock_sim.ros.log import ros_context
from flock_sim.ros.machine import machine_with_ros
from flock_sim.ros.process import executing
from flock_sim.ros.settings_check import check_settings
from flock_sim.ros.watchdog import Watchdog

if TYPE_CHECKING:
    import xarray as xr


def fly(
    configuration: FlockConfiguration | None = None,
    *,
    bird: Callable[..., BirdNode] = BirdNode,
    timeout: float = 60.0,
    output: str | Path | None = None,
    force: bool = False,
    **parameters: Any,
) -> xr.Dataset:
    """Fly a flock over ROS 2 in this process. Return what `flock_tools.runs.dataset.load` returns.

        flight = fly(birds=3, t_max=100, links=["hold:interval=10"])
        assert float(flight.speed[-1].std("bird").max()) < 0.01

    Clock, recorder and birds are the nodes of `flock fly`. Each runs in a thread of its own. The
    flight has a ROS domain of its own, and discovery stays on this machine. `parameters` are keys
    of the configuration file. They override `configuration`. `bird` creates all birds: BirdNode or
    a replacement, such as a subclass; the bag names its class. With `output` the
    bag is kept there; with `force` it replaces another one. The environment, temporary files and
    shared memory are restored afterwards. Other ROS contexts of the process are not touched. Only
    one such flight may run at a time, because the flight changes the environment of the process.

    Raises FlockError on bad input, RunFailed after `timeout` s of standstill, and any exception of
    your own birds.
    """
    # Imported here: only a call needs it.
    from flock_tools.runs.dataset import load

    positive_number("timeout", str(timeout))
    known = {} if configuration is None else configuration.parameters()
    flown = FlockConfiguration.given({**known, **parameters})
    topics.steps_ahead(flown, False)  # raises if the flight can't be recorded
    if flown.links and flown.birds > 1:
        warm_links()  # now, so that no bird makes the others wait
    with tempfile.TemporaryDirectory(prefix="flock-") as temporary:
        bag = Path(temporary) / "flight" if output is None else Path(output)
        with own_output(bag, force) as owned:
            machines = [machine_with_ros()]
            with (
                ros_alone() as context,
                recording(
                    bag, flown, grants=True, machines=machines, replace=owned.replaces
                ) as run,
            ):
                _fly(flown, bird, timeout, run, context)
            return load(bag)


@contextmanager
def ros_alone() -> Iterator[Context]:
    """Give a ROS context on an unused domain. Restore the environment at the end."""
    names = (DOMAIN, RANGE, LOCALHOST_ONLY, *PROFILES, *ELSEWHERE)
    before = {name: os.environ.get(name) for name in names}
    try:
        for name in (RANGE, LOCALHOST_ONLY, *ELSEWHERE):
            os.environ.pop(name, None)
        with held_domain(quiet_domains()) as domain:
            if domain is None:
                raise RunFailed("every ROS domain is in use: end other flights first")
            os.environ[DOMAIN] = str(domain)
            prepare_discovery()
            context = ros_context()
            try:
                yield context
            finally:
                rclpy.try_shutdown(context=context)
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _fly(
    configuration: FlockConfiguration,
    bird: Callable[..., BirdNode],
    timeout: float,
    run: Recording,
    context: Context,
) -> None:
    """Fly to the end: the clock in this thread, the birds in a second, the recorder in a third."""
    run_id = new_run_id()
    keeper = Timekeeper(configuration, run_id, WINDOW, record=True)
    over = Over()
    with ExitStack() as held:
        of_clock, of_birds, of_recorder = (
            held.enter_context(executing(EXECUTORS[0], context)) for _ in range(3)
        )
        depth = topics.depth(topics.CLOCK_TOPIC, configuration)
        clock = ClockNode(keeper, depth, context=context)
        of_clock.add_node(clock)
        check_settings(context.get_domain_id())
        recorder = RecorderNode(configuration, run, run_id, False, context=context)
        of_recorder.add_node(recorder)
        indices = range(1, configuration.birds + 1)
        birds = create_birds(indices, configuration, run_id, of_birds, kind=bird)

        def watchdog() -> Watchdog:
            return Watchdog(timeout + NODE_MARGIN, lambda line: None)

        parts = [
            Part("the recorder", over, lambda: record(recorder, of_recorder, over, watchdog())),
            Part("the birds", over, lambda: fly_together(birds, of_birds, over, watchdog())),
        ]
        with ended_together(parts, over):
            keep_time(clock, of_clock, Watchdog(timeout, note), lambda: over)
            clock.release()


class Over(Stop):
    """A stop that ignores signals: the caller's process handles them."""

    def __init__(self) -> None:
        """Start in the state of not stopped."""
        self.signal = 0
        self.said = False

    def __bool__(self) -> bool:
        return self.said


class Part(threading.Thread):
    """A thread of a flight. Its exception is kept in `error`, and ends the other threads."""

    def __init__(self, name: str, over: Over, work: Callable[[], None]) -> None:
        """Prepare a thread that runs `work`."""
        super().__init__(name=name, daemon=True)
        self.error: BaseException | None = None
        self._over = over
        self._work = work

    def run(self) -> None:
        """Run the work of this thread."""
        try:
            self._work()
        except BaseException as error:  # raised again by ended_together
            self.error = error
            self._over.said = True


@contextmanager
def ended_together(parts: Sequence[Part], over: Over) -> Iterator[None]:
    """Run `parts` beside the block, and wait for their ends. A part that fails ends all parts.

    Raises the exception of the first part that failed, or RunFailed if a part does not end.
    """
    for part in parts:
        part.start()
    try:
        yield
        for part in parts:
            part.join(JOIN_LIMIT)
    finally:
        over.said = True
        for part in parts:
            part.join(JOIN_LIMIT)
    for part in parts:
        if part.error:
            raise part.error
        if part.is_alive():
            raise RunFailed(f"{part.name} did not end within {2 * JOIN_LIMIT:g} s of the flight")
