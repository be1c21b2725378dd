# SPDX-License-Identifier: Apache-2.0
"""Recording a playback gives an equal bag. Missing parts are reported."""

from __future__ import annotations

from pathlib import Path

import pytest

from flock_interfaces import srv
from flock_interfaces.msg import Perturbation
from flock_sim.bag.reading.reader import BagReader
from flock_sim.messages import topics
from flock_sim.messages.types import Push
from flock_sim.recording.run import Run
from flock_sim.ros.endpoints import latched
from support.bags import assert_equal
from support.terminal import Job, Terminal
from support.visitor import Visitor

FLOCK = ("--birds", 3, "--t-max", 2000, "--record-every", 2, "--span-ratio", "1=0.98,1.0")
GIVEN = ("birds:=3", "t_max:=2000.0", "record_every:=2", "span_ratios:=['1=0.98,1.0']")
HEARD = "the topics of all birds and /clock are found"
NO_PUSH = Push(0, 10, 0.1, 0.0, number=1, bird=4, member=1)
"""A push that no flight of three birds can have."""


def recorder(terminal: Terminal, output: str, *given: str) -> Job:
    parameters = (f"output:={output}", "played:=true", "timeout:=60.0", *given)
    words = [word for parameter in parameters for word in ("-p", parameter)]
    return terminal.start("recorder", "--ros-args", *words)


def played_again(terminal: Terminal, visitor: Visitor, bag: str, *given: str) -> None:
    """Record what is played of `bag` as `again`."""
    player = terminal.start("play", bag, "--rate", 0, "--paused")
    job = recorder(terminal, "again", *given).until_said(HEARD)
    outlet = visitor.node.create_publisher(Perturbation, topics.PERTURBATION_TOPIC, latched(1))
    visitor.until(lambda: outlet.get_subscription_count() > 0)
    outlet.publish(NO_PUSH.encode())
    visitor.ask(srv.Resume, "/flock/player/resume")
    visitor.until(lambda: not job.running)
    done = job.wait()
    assert done.status == 0, done.stderr
    assert player.wait().status == 0


def states(bag: Path) -> list[bytes]:
    with BagReader(bag) as opened:
        names = [name for name in opened.topics if name.endswith(("/state", "/wing", "/clock"))]
        return [data for name in names for _, _, data in opened.messages([name])]


def test_a_played_reference_is_recorded_to_the_byte(terminal: Terminal, visitor: Visitor) -> None:
    terminal.well("reference", *FLOCK, "--output", "bag")
    played_again(terminal, visitor, "bag", *GIVEN)
    assert_equal(terminal, "again", "bag", messages=3 * 1001)
    assert states(terminal.directory / "again") == states(terminal.directory / "bag")
    with Run(terminal.directory / "again") as again:
        assert again.perturbations() == []


def test_a_played_flight_over_bad_links_is_recorded_with_its_pushes(
    terminal: Terminal, visitor: Visitor
) -> None:
    link = "links:=['linear:interval=10,delay=5']"
    flight = ("--birds", 3, "--t-max", 500, "--link", "linear:interval=10,delay=5")
    terminal.well("fly", *flight, "--perturb", "2@100=0.1,-0.01", "--output", "bag")
    given = ("birds:=3", "t_max:=500.0", link, "perturbations:=['2@100=0.1,-0.01']")
    played_again(terminal, visitor, "bag", *given)
    assert_equal(terminal, "again", "bag", messages=3 * 51)
    with Run(terminal.directory / "again") as again, Run(terminal.directory / "bag") as run:
        assert again.metrics().as_json() == run.metrics().as_json()


@pytest.mark.parametrize(
    ("given", "status", "words"),
    [
        (("span_ratios:=['1=0.9,1.0']",), 2, "is played with span ratio [0.98 1.  ]"),
        (
            GIVEN[3:],
            1,
            "step 1 was not received: start the recorder first, then play the whole bag of a",
        ),
    ],
)
def test_another_flight_than_was_told_is_no_bag(
    terminal: Terminal, given: tuple[str, ...], status: int, words: str
) -> None:
    # The second recorder is told nothing of record_every, and expects what the bag does not hold.
    terminal.well("reference", *FLOCK, "--output", "bag")
    job = recorder(terminal, "again", *GIVEN[:2], "record_every:=1", *given)
    player = terminal.start("play", "bag", "--loop")
    done = job.wait()
    assert done.status == status
    assert words in done.error
    player.interrupt()
    player.wait()


@pytest.mark.parametrize("other", ["resume:=true", "record_stages:=true", "run_id:=4"])
def test_what_a_played_flight_does_not_have_is_refused(terminal: Terminal, other: str) -> None:
    done = recorder(terminal, "again", other).wait()
    assert done.status == 2
    assert done.error.startswith(f"error: {other.partition(':')[0]} = ")
    assert not (terminal.directory / "again").exists()
