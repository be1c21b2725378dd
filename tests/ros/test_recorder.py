# SPDX-License-Identifier: Apache-2.0
"""Steps that the recorder reports as saved are on disk: they are the checkpoint of a resumption."""

from __future__ import annotations

import pytest
from std_srvs.srv import Trigger

from flock_interfaces.msg import Progress
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.output_directory import own_output
from flock_sim.recording.run import Run
from flock_sim.ros.endpoints import latched
from support.flights import flown_rows
from support.terminal import Terminal
from support.visitor import Visitor


@pytest.mark.slow
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


def test_a_recorder_by_hand_keeps_off_a_bag_that_is_recorded_to(terminal: Terminal) -> None:
    flown = FlockConfiguration(birds=2, t_max=20.0)
    bag = terminal.directory / "bag"
    with own_output(bag, force=False), recording(bag, flown, grants=True) as run:
        for row in flown_rows(flown)[:2]:
            run.write_row(row)
        run.flush()
        for how in ("force:=true", "resume:=true"):
            words = ("-p", "output:=bag", "-p", how, "-p", "birds:=2", "-p", "t_max:=20.0")
            done = terminal.run("recorder", "--ros-args", *words)
            assert done.status == 2
            assert "another process is recording to bag" in done.error
        assert not (bag / "metadata.yaml").exists()
    with Run(bag) as whole:
        assert whole.configuration == flown
        assert sum(1 for _ in whole.states()) == 4
