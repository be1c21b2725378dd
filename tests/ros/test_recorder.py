# SPDX-License-Identifier: Apache-2.0
"""What the recorder calls safe is on disk: the checkpoint that a flight can be resumed from."""

from __future__ import annotations

from std_srvs.srv import Trigger

from flock_interfaces.msg import Progress
from flock_sim.core import topics
from flock_sim.nodes.endpoints import latched
from flock_sim.run import Run
from terminal import Terminal
from visitor import Visitor


def test_every_step_that_the_recorder_calls_safe_can_be_read_at_that_moment(
    terminal: Terminal, visitor: Visitor
) -> None:
    heard: list[int] = []

    def hear(progress: Progress) -> None:
        if progress.who == topics.RECORDER and progress.step >= 0:
            heard.append(progress.step)
            # The file only grows: what is read now was there when the message came, or a bit later.
            assert Run(terminal.directory / "bag").at().step >= progress.step

    visitor.node.create_subscription(Progress, topics.PROGRESS_TOPIC, hear, latched(1))
    # Stages would make chunks fill up by themselves; few small states must be put on disk for it.
    flight = ("--birds", 2, "--t-max", 1e8, "--record-every", 50, "--window", 1)
    job = terminal.start("fly", *flight, "--output", "bag")
    visitor.until(lambda: len(heard) >= 8)  # however late it is found: the flight goes on
    assert visitor.ask(Trigger, "/flock/clock/stop").success
    visitor.until(lambda: not job.running)
    assert job.wait().status == 0
    assert heard == sorted(heard)
    assert heard[-1] > heard[0]
