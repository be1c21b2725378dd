# SPDX-License-Identifier: Apache-2.0
"""The services of the clock control a flight, and /diagnostics describes its state."""

from __future__ import annotations

import math
import os
import re
import signal
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from flock_interfaces.msg import Grant
from flock_interfaces.srv import Perturb, Step
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.messages import topics
from flock_sim.recording.run import Run
from support.bags import assert_begins_as, assert_equal, last_step
from support.terminal import Job, Terminal
from support.visitor import Visitor, values, visiting

STEPS = 60000  # so long that no flight ends before it is asked for something: nobody would answer
EVERY = 40
FLOCK = ("--birds", 2, "--t-max", STEPS, "--record-every", EVERY, "--span-ratio", "2=0.97,1.03")
STATES = 2 * (STEPS // EVERY + 1)

CLOCK_KEYS = {
    "step",
    "end",
    "steps per second",
    "waiting for",
    "epoch",
    "rewinds",
    "steps flown again",
    "recorder lag",
    "ignored",
}
RECORDER_KEYS = {"saved", "epoch", "ignored"}


@pytest.fixture(autouse=True)
def prepared(visitor: Visitor) -> None:
    """Look for the services from the start."""
    look_for_services(visitor)


def look_for_services(visitor: Visitor) -> None:
    """Create the clients before a flight begins: it may be over before a later one is found."""
    for name in ("pause", "resume", "stop"):
        visitor.client(Trigger, f"/flock/clock/{name}")
    visitor.client(Step, "/flock/clock/step")
    visitor.client(Perturb, "/flock/clock/perturb")


def in_flight(terminal: Terminal, *how: object) -> Job:
    """Start a flight, and wait until some of it is on disk."""
    job = terminal.start("fly", *FLOCK, *how, "--output", "bag", "--json")
    job.until(lambda: last_step(terminal.directory / "bag") > 0)
    return job


def trigger(visitor: Visitor, name: str) -> str:
    """Call pause, resume or stop; return what is said."""
    answer = visitor.ask(Trigger, f"/flock/clock/{name}")
    assert answer.success
    return str(answer.message)


def step_in(said: str) -> int:
    """Return the step that an answer names."""
    found = re.search(r"at step (\d+)", said)
    assert found, said
    return int(found[1])


def perturb(visitor: Visitor, **push: Any) -> Perturb.Response:
    """Ask for a push."""
    return visitor.ask(Perturb, "/flock/clock/perturb", **push)


class Watch:
    """What a flight tells of where it is."""

    def __init__(self, visitor: Visitor) -> None:
        self._visitor = visitor
        self.clock = visitor.diagnostics("flock: clock")
        self.recorder = visitor.diagnostics("flock: recorder")
        self.grants = visitor.hear(Grant, topics.GRANT_TOPIC)

    def until_paused_at(self, step: int, reports: int = 2) -> None:
        """Wait until the flock is at `step`, and hold that it stays for some `reports`."""
        words = f"paused, at step {step} of {STEPS}"
        self._visitor.until(lambda: self.clock and self.clock[-1].message == words)
        saved = str(step - step % EVERY)
        self._visitor.until(lambda: self.recorder and values(self.recorder[-1])["saved"] == saved)
        since = len(self.clock), len(self.recorder)
        self._visitor.until(lambda: len(self.clock) >= since[0] + reports)
        assert {status.message for status in self.clock[since[0] :]} == {words}
        assert {values(status)["saved"] for status in self.recorder[since[1] :]} == {saved}
        assert self.grants[-1].step == step


@pytest.mark.slow
def test_a_flock_pauses_goes_on_by_steps_and_flies_on(terminal: Terminal, visitor: Visitor) -> None:
    # Longer than the timeout, which starting must fit into: 12 reports, one a second.
    job = in_flight(terminal, "--timeout", 10)
    watch = Watch(visitor)
    paused = step_in(trigger(visitor, "pause"))
    assert paused < STEPS
    watch.until_paused_at(paused, reports=12)
    for steps in (1, 37):
        answer = visitor.ask(Step, "/flock/clock/step", steps=steps)
        paused += steps
        assert answer.success
        assert step_in(answer.message) == paused
        watch.until_paused_at(paused)
    refused = visitor.ask(Step, "/flock/clock/step", steps=0)
    assert (refused.success, refused.message) == (False, "steps = 0: must be 1 or more")
    trigger(visitor, "resume")
    done = job.wait()
    assert done.status == 0, done.stderr
    assert done.json["rewinds"] == 0
    terminal.well("reference", *FLOCK, "--output", "reference")
    assert_equal(terminal, "bag", "reference", STATES)


def test_a_flight_that_is_stopped_is_complete_up_to_there_and_can_be_resumed(
    terminal: Terminal, visitor: Visitor
) -> None:
    job = in_flight(terminal)
    grants = visitor.hear(Grant, topics.GRANT_TOPIC)
    trigger(visitor, "stop")
    done = job.wait()
    assert done.status == 0, done.stderr
    visitor.until(lambda: grants and grants[-1].step > grants[-1].end)
    end = grants[-1].end
    assert 0 < end < STEPS
    assert f"note: the flight was ended at step {end} of {STEPS}; fly --resume" in done.stderr
    assert done.json["last_step"] == end
    terminal.well("reference", *FLOCK, "--output", "reference")
    bag, reference = (terminal.directory / name for name in ("bag", "reference"))
    with Run(bag) as run:
        assert run.bag.missing is None
        assert run.missing is not None
        assert "the flight was ended" in run.missing
    assert assert_begins_as(bag, reference) == 2 * (end // EVERY + 1)
    terminal.well("fly", "--resume", "bag")
    assert_equal(terminal, "bag", "reference", STATES)


@pytest.mark.parametrize("killed", [False, True], ids=["undisturbed", "a-bird-killed-after-it"])
@pytest.mark.slow
def test_a_push_asked_for_in_flight_is_recorded_and_can_be_repeated(
    terminal: Terminal, visitor: Visitor, killed: bool
) -> None:
    job = in_flight(terminal, "--processes", 1 + killed)
    one = perturb(visitor, bird=2, member=1, step=0, position=0.01, speed=0.0)
    assert one.success, one.message
    assert one.message == f"bird 2 is pushed at step {one.step}"
    trigger(visitor, "pause")
    both = visitor.until(
        lambda: (
            answer
            if (answer := perturb(visitor, bird=1, member=0, step=STEPS - 5, speed=1e-3)).success
            else None
        )
    )
    assert both.step == STEPS - 5
    trigger(visitor, "resume")
    if killed:
        os.kill(job.workers("flock_sim.nodes.bird_process")[0], signal.SIGKILL)
    done = job.wait()
    assert done.status == 0, done.stderr
    assert done.json["restarts"] == killed
    with Run(terminal.directory / "bag") as run:
        assert run.perturbations() == [
            Perturbation(one.step, 2, 1, 0.01, 0.0),
            Perturbation(STEPS - 5, 1, 1, 0.0, 1e-3),
            Perturbation(STEPS - 5, 1, 2, 0.0, 1e-3),
        ]
    terminal.well("reference", "--repeat", "bag", "--output", "repeated")
    assert_equal(terminal, "bag", "repeated", STATES)
    terminal.well("reference", *FLOCK, "--output", "unpushed")
    assert terminal.run("compare", "bag", "unpushed").status == 1


@pytest.mark.slow
def test_pushes_before_and_after_a_kill_of_all_are_flown_by_all_members(
    terminal: Terminal, visitor: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = in_flight(terminal)
    first = perturb(visitor, bird=1, member=0, step=0, position=0.01, speed=0.0)
    assert first.success, first.message
    bag = terminal.directory / "bag"
    job.until(lambda: last_step(bag) > first.step)
    job.kill()
    # `visitor` knows the killed clock for 20 s more: a request may go to it, and get lost.
    with visiting(terminal, monkeypatch) as later:
        look_for_services(later)
        job = terminal.start("fly", "--resume", "bag", "--json")
        second = later.until(
            lambda: (
                answer
                if (answer := perturb(later, bird=2, member=0, step=0, position=0.02)).success
                else None
            )
        )
    done = job.wait()
    assert done.status == 0, done.stderr
    with Run(bag) as run:
        assert run.perturbations() == [
            *(Perturbation(first.step, 1, member, 0.01, 0.0) for member in (1, 2)),
            *(Perturbation(second.step, 2, member, 0.02, 0.0) for member in (1, 2)),
        ]
    terminal.well("reference", "--repeat", "bag", "--output", "repeated")
    assert_equal(terminal, "bag", "repeated", STATES)


def test_a_push_that_can_t_be_is_refused_and_disturbs_nothing(
    terminal: Terminal, visitor: Visitor
) -> None:
    job = in_flight(terminal)
    trigger(visitor, "pause")
    push = {"bird": 1, "member": 1, "step": 0, "position": 0.1, "speed": 0.0}
    for wrong, named in (
        ({"bird": 9}, "bird 9 is not among 1..2"),
        ({"bird": 0}, "bird 0 is not among 1..2"),
        ({"member": 9}, "member 9 is not among 1..2"),
        ({"step": 1}, "step = 1: must be "),
        ({"step": STEPS + 1}, f"and the flight ends at {STEPS}"),
        ({"position": math.nan}, "nan must be finite"),
        ({"speed": math.inf}, "inf must be finite"),
    ):
        answer = perturb(visitor, **{**push, **wrong})
        assert not answer.success
        assert named in answer.message
        assert "\n" not in answer.message
    trigger(visitor, "resume")
    done = job.wait()
    assert done.status == 0, done.stderr
    assert done.json["rewinds"] == 0
    with Run(terminal.directory / "bag") as run:
        assert run.perturbations() == []
    terminal.well("reference", *FLOCK, "--output", "reference")
    assert_equal(terminal, "bag", "reference", STATES)


def test_clock_and_recorder_tell_how_they_are(terminal: Terminal, visitor: Visitor) -> None:
    job = in_flight(terminal)
    trigger(visitor, "pause")
    watch = Watch(visitor)
    visitor.until(lambda: watch.clock and watch.clock[-1].message.startswith("paused"))
    visitor.until(lambda: len(watch.recorder) >= 2)
    clock, recorder = watch.clock[-1], watch.recorder[-1]
    assert values(clock).keys() >= CLOCK_KEYS
    assert values(recorder).keys() >= RECORDER_KEYS
    assert (clock.level, recorder.level) == (DiagnosticStatus.OK, DiagnosticStatus.OK)
    assert values(clock)["end"] == str(STEPS)
    assert values(clock)["epoch"] == values(recorder)["epoch"]
    assert values(clock)["rewinds"] == "0"
    saved = values(recorder)["saved"]
    assert recorder.message == f"step {saved} of {STEPS} is on disk"
    trigger(visitor, "stop")
    assert job.wait().status == 0


def test_birds_that_fly_freely_are_neither_held_nor_pushed(
    terminal: Terminal, visitor: Visitor
) -> None:
    job = in_flight(terminal, "--mode", "free", "--real-time-factor", 5)
    for kind, name in ((Trigger, "pause"), (Trigger, "stop"), (Step, "step"), (Perturb, "perturb")):
        answer = visitor.ask(kind, f"/flock/clock/{name}")
        assert not answer.success
        assert "free flight" in answer.message
    job.interrupt()
    assert job.wait().status == 130
    terminal.well("metrics", "bag", "--json")
