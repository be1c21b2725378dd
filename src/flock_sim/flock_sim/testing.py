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

from flock_sim.bag.output import claim_output
from flock_sim.command_line import note, positive_number
from flock_sim.core import topics
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.timekeeper import Timekeeper, new_run_id
from flock_sim.discovery import (
    DOMAIN,
    ELSEWHERE,
    PROFILES,
    RANGE,
    held_domain,
    prepare_discovery,
    quiet_domains,
)
from flock_sim.errors import RunFailed
from flock_sim.nodes import EXECUTORS
from flock_sim.nodes.bird import BirdNode, fly_together, hatch
from flock_sim.nodes.clock import ClockNode, first_epoch, keep_time
from flock_sim.nodes.patience import Patience
from flock_sim.nodes.process import executing, ros_context
from flock_sim.nodes.recorder import RecorderNode, record
from flock_sim.recording import Recording, recording
from flock_sim.stop import Stop

if TYPE_CHECKING:
    import xarray as xr

WINDOW = 64
"""Steps granted ahead."""

PATIENCE_OF_OTHERS = 30.0
"""How much longer, in s, than the clock the others wait: it is the clock that ends a flight."""

JOIN_LIMIT = 60.0
"""How long, in s, the others may take to end after the flight has."""


def fly_in_process(
    configuration: FlockConfiguration | None = None,
    *,
    bird: Callable[..., BirdNode] = BirdNode,
    timeout: float = 60.0,
    output: str | Path | None = None,
    **parameters: Any,
) -> xr.Dataset:
    """Fly a flock over ROS 2 in this process, and return what `flock_tools.dataset.load` does.

        flight = fly_in_process(birds=3, t_max=100, links=["hold:interval=10"])
        assert float(flight.speed[-1].std("bird").max()) < 0.01

    Clock, recorder and birds are the nodes of `flock fly`, in threads of their own, on a ROS domain
    of their own, and look for nobody beyond this machine. `parameters` are keys of the
    configuration file, and win over `configuration`; `bird` is BirdNode or what takes its place for
    all birds, such as a subclass with a `control`. With `output` the bag stays there. Afterwards
    environment, temporary files and shared memory are as before; other ROS contexts of the process
    are left alone. One such flight at a time: the environment is the process's.

    Raises FlockError on bad input, RunFailed after `timeout` s of standstill, and whatever a bird
    of yours raises.
    """
    # Of the package that depends on this one, and so not known to it before somebody asks.
    from flock_tools.dataset import load

    positive_number("timeout", str(timeout))
    known = {} if configuration is None else configuration.parameters()
    flown = FlockConfiguration.from_parameters({**known, **parameters})
    topics.steps_ahead(flown, False)  # refuses what can't be recorded
    with tempfile.TemporaryDirectory(prefix="flock-") as temporary:
        bag = Path(temporary) / "flight" if output is None else Path(output)
        claim_output(bag, force=False)
        with ros_alone() as context, recording(bag, flown, grants=True) as run:
            _fly(flown, bird, timeout, run, context)
        return load(bag)


@contextmanager
def ros_alone() -> Iterator[Context]:
    """Give a ROS context on a domain that nobody else is on; all is as before at the end."""
    names = (DOMAIN, RANGE, *PROFILES, *ELSEWHERE)
    before = {name: os.environ.get(name) for name in names}
    try:
        for name in (RANGE, *ELSEWHERE):
            os.environ.pop(name, None)
        with held_domain(quiet_domains()) as domain:
            if domain is None:
                raise RunFailed("every ROS domain is in use: end other flights first")
            os.environ[DOMAIN] = str(domain)
            prepare_discovery()
            context = ros_context(["--ros-args", "--disable-external-lib-logs"])
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
    """Fly to the end: the clock in this thread, birds and recorder in one each."""
    run_id = new_run_id()
    keeper = Timekeeper(configuration, run_id, WINDOW, True, False, first_epoch())
    over = Over()
    with ExitStack() as held:
        of_clock, of_birds, of_recorder = (
            held.enter_context(executing(EXECUTORS[0], context)) for _ in range(3)
        )
        depth = topics.depth(topics.CLOCK_TOPIC, configuration)
        clock = ClockNode(keeper, depth, context=context)
        of_clock.add_node(clock)
        recorder = RecorderNode(configuration, run, run_id, False, context=context)
        of_recorder.add_node(recorder)
        indices = range(1, configuration.birds + 1)
        birds = hatch(indices, configuration, run_id, of_birds, kind=bird)

        def patience() -> Patience:
            return Patience(timeout + PATIENCE_OF_OTHERS, lambda line: None)

        parts = [
            Part("the recorder", over, lambda: record(recorder, of_recorder, over, patience())),
            Part("the birds", over, lambda: fly_together(birds, of_birds, over, patience())),
        ]
        with ended_together(parts, over):
            keep_time(clock, of_clock, Patience(timeout, note), lambda: over)
            clock.release()


class Over(Stop):
    """A stop that heeds no signals: those are for whoever runs this process."""

    def __init__(self) -> None:
        """Let all go on."""
        self.signal = 0
        self.said = False

    def __bool__(self) -> bool:
        return self.said


class Part(threading.Thread):
    """A thread of a flight. What it fails with is kept in `error`, and ends the others."""

    def __init__(self, name: str, over: Over, work: Callable[[], None]) -> None:
        """Do `work` once started."""
        super().__init__(name=name, daemon=True)
        self.error: BaseException | None = None
        self._over = over
        self._work = work

    def run(self) -> None:
        """Work."""
        try:
            self._work()
        except BaseException as error:  # raised again where the flight was asked for
            self.error = error
            self._over.said = True


@contextmanager
def ended_together(parts: Sequence[Part], over: Over) -> Iterator[None]:
    """Run `parts` beside the block, and wait for their ends; whoever fails ends all.

    Raises what the first of them failed with, and RunFailed where one does not end.
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
