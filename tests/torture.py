# SPDX-License-Identifier: Apache-2.0
"""Flights whose processes are killed at random, until enough were: `make torture`.

    torture.py [--kills K] [--seed S]

Every other flight is one of nodes by hand (clock, recorder and each bird a process, each started
again at once), the others are `fly`, whose workers are killed, or all of it, and resumed. Moments
are drawn so that some kills meet the start, some a rewind, some the end. Where a flight has two
kills or more, one meets birds that fly. Each bag must equal the reference's. Prints what it came
to.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from flock_sim.messages import topics
from flock_sim.messages.types import Grant
from flock_sim.recording.run import Run
from support.bags import last_step
from support.terminal import Job, Terminal, open_terminal

BIRDS = 4
EVERY = 10
FLOCK = ("--birds", BIRDS, "--record-every", EVERY, "--span-ratio", "2=0.97,1.03")
LENGTHS = (6000, 20000, 40000)
"""Steps of a flight."""

LIMIT = 240.0
"""Time, in s, within which a flight ends however often it is hit."""


@dataclass
class Toll:
    """What was done to the flights, and what it cost."""

    kills: dict[str, int] = field(default_factory=dict)
    flights: int = 0
    rewinds: int = 0
    steps: int = 0
    flown_again: int = 0
    standstill: float = 0.0
    states: int = 0

    @property
    def killed(self) -> int:
        """Kills so far."""
        return sum(self.kills.values())

    def kill(self, what: str) -> None:
        """Count a kill."""
        self.kills[what] = self.kills.get(what, 0) + 1

    def __str__(self) -> str:
        each = ", ".join(f"{count} of {what}" for what, count in sorted(self.kills.items()))
        return (
            f"{self.killed} kills ({each}) in {self.flights} flights of {self.steps} steps in all\n"
            f"{self.rewinds} rewinds, at most {self.flown_again} steps flown again\n"
            f"longest time between two rows on disk: {self.standstill:.1f} s\n"
            f"{self.states} states equal the reference's bit for bit, each exactly once"
        )


class Watch:
    """Follows the growth of a bag's file, which only new rows make once there is one of a step."""

    def __init__(self, bag: Path) -> None:
        self._bag = bag
        self._size = 0
        self._grown: float | None = None
        self.longest = 0.0

    def grew(self) -> bool:
        """Look; return whether there are more steps than before."""
        size = sum(file.stat().st_size for file in self._bag.glob("*.mcap"))
        now = time.monotonic()
        if size <= self._size:
            return False
        self._size = size
        if self._grown is not None:
            self.longest = max(self.longest, now - self._grown)
        elif last_step(self._bag) <= 0:
            return False
        self._grown = now
        return True


AT_NEW_ROWS = (math.inf, math.inf)
"""The moment of a kill that waits for new rows on disk."""


class Executioner:
    """Draws the moments of kills, and the victims: none so often that nothing can ever be flown.

    The first kill of a flight may come before it flies. The second one waits for new rows, so that
    each flight of two kills is hit in flight, however long its processes take to start.
    """

    MERCY = 3

    def __init__(self, random: Random, budget: int, pace: float) -> None:
        """Kill `budget` times; moments are drawn as for flights `pace` times as long."""
        self._random = random
        self.left = budget
        self._pace = pace
        self._hits: dict[str, int] = {}
        self._due = self._soon(0.0, 4.0)
        self._second = True

    def _soon(self, low: float, high: float) -> float:
        """Return a monotonic time, in s, between `low` and `high` s of a long flight from now."""
        if low == math.inf:
            return math.inf
        return time.monotonic() + self._random.uniform(low, high) / self._pace

    def victim(self, candidates: dict[str, int], grew: bool) -> tuple[str, int] | None:
        """Return who is to be killed now, if anybody: (who, process)."""
        if grew:
            self._hits.clear()
            if self._due == math.inf:
                self._due = self._soon(0.0, 1.0)
        if time.monotonic() < self._due or not self.left:
            return None
        spared = {w: p for w, p in candidates.items() if self._hits.get(w, 0) < self.MERCY}
        if not spared:
            return None
        who = self._random.choice(sorted(spared))
        self._hits[who] = self._hits.get(who, 0) + 1
        self.left -= 1
        # Soon, while others recover; a little later; or not before there are new rows on disk.
        moments = [AT_NEW_ROWS] if self._second else [(0.0, 0.3), (0.3, 2.0), *2 * [AT_NEW_ROWS]]
        self._due = self._soon(*self._random.choice(moments))
        self._second = False
        return who, spared[who]


def torture(
    terminal: Terminal,
    seed: int,
    kills: int,
    per_flight: int = 12,
    lengths: Sequence[int] = LENGTHS,
    pace: float = 1.0,
    say: Callable[[str], None] = print,
) -> Toll:
    """Fly until `kills` processes were killed; check every bag against the reference's."""
    random = Random(seed)
    toll = Toll()
    for flight in itertools.count():
        steps = random.choice(lengths)
        bag = f"flight-{flight}"
        executioner = Executioner(random, min(per_flight, kills - toll.killed), pace)
        fly = by_hand if flight % 2 else composed
        fly(terminal, bag, steps, executioner, toll, random)
        judge(terminal, bag, steps, toll)
        say(f"{fly.__name__} {bag}: {toll.killed} kills, equal to the reference")
        if toll.killed >= kills:
            return toll
    raise AssertionError


def composed(
    terminal: Terminal, bag: str, steps: int, executioner: Executioner, toll: Toll, random: Random
) -> None:
    """Let `fly` fly in two processes and the recorder's; go on by --resume where all are killed."""
    how = ("--processes", 2, "--json")
    anew = ("fly", *FLOCK, "--t-max", steps, *how, "--output", bag, "--force")
    watch = Watch(terminal.directory / bag)
    deadline = time.monotonic() + LIMIT
    job = terminal.start(*anew)
    while job.running:
        assert time.monotonic() < deadline, job.stderr
        grew = watch.grew()
        candidates = {"fly": job.process.pid}
        for kind in ("bird", "recorder"):
            for k, pid in enumerate(sorted(job.workers(f"flock_sim.nodes.{kind}_process"))):
                candidates[f"{kind} process {k}"] = pid
        if found := executioner.victim(candidates, grew):
            who, pid = found
            if who != "fly":
                if kill(pid):
                    toll.kill(f"a {who[:-2]}")
            elif job.kill().status == -signal.SIGKILL:
                toll.kill("fly and all of its processes")
                begun = any((terminal.directory / bag).glob("*.mcap"))
                job = terminal.start(*(("fly", "--resume", bag, *how) if begun else anew))
        time.sleep(0.01)  # between two looks at processes, which nothing announces
    assert job.wait().status == 0, job.stderr
    toll.standstill = max(toll.standstill, watch.longest)


def by_hand(
    terminal: Terminal, bag: str, steps: int, executioner: Executioner, toll: Toll, random: Random
) -> None:
    """Let nodes by hand fly, each a process that is started again whenever it is killed."""
    flock = (
        "-p",
        f"birds:={BIRDS}",
        "-p",
        f"t_max:={float(steps)}",
        "-p",
        f"record_every:={EVERY}",
    )
    flock += ("-p", "span_ratios:=['2=0.97,1.03']", "-p", "timeout:=60.0")
    commands: dict[str, tuple[object, ...]] = {
        "clock": ("clock", "--ros-args", *flock),
        "recorder": (
            "recorder",
            "--ros-args",
            *flock,
            "-p",
            f"output:={bag}",
            "-p",
            "resume:=true",
        ),
    }
    for bird in range(1, BIRDS + 1):
        commands[f"bird {bird}"] = ("bird", "--ros-args", *flock, "-p", f"index:={bird}")
    watch = Watch(terminal.directory / bag)
    deadline = time.monotonic() + LIMIT
    jobs = {
        who: terminal.start(*commands[who])
        for who in random.sample(sorted(commands), len(commands))
    }
    while jobs["recorder"].running or jobs["recorder"].process.returncode < 0:
        assert time.monotonic() < deadline, {who: job.stderr for who, job in jobs.items()}
        candidates = {who: job.process.pid for who, job in jobs.items() if job.running}
        if found := executioner.victim(candidates, watch.grew()):
            who, pid = found
            if kill(pid):
                toll.kill("a bird" if who.startswith("bird") else f"the {who}")
            jobs[who].wait()
        for who, job in jobs.items():
            if job.running:
                continue
            assert job.process.returncode <= 0, f"{who}: {job.stderr}"
            if job.process.returncode < 0:
                jobs[who] = terminal.start(*commands[who])
        time.sleep(0.01)  # between two looks at processes, which nothing announces
    assert jobs["recorder"].wait().status == 0, jobs["recorder"].stderr
    for job in jobs.values():  # who was killed after the end waits for a flight that is over
        end(job)
    toll.standstill = max(toll.standstill, watch.longest)


def judge(terminal: Terminal, bag: str, steps: int, toll: Toll) -> None:
    """Compare a bag with the reference's; add to the toll what it tells."""
    reference = f"reference-{steps}"
    if not (terminal.directory / reference).exists():
        terminal.well("reference", *FLOCK, "--t-max", steps, "--output", reference)
    done = terminal.run("compare", bag, reference, "--json")
    assert done.status == 0, done.stdout + done.stderr
    assert done.json["messages"] == BIRDS * (steps // EVERY + 1)
    with Run(terminal.directory / bag) as run:
        assert run.missing is None
        grants = [
            (
                run.configuration.stamp(EVERY)
                and round(time / run.configuration.stamp(EVERY)) * EVERY,
                Grant.decode(data),
            )
            for _, time, data in run.bag.messages(topics=[topics.GRANT_TOPIC])
        ]
    furthest, epoch = 0, grants[0][1].epoch
    for start, grant in grants:
        if grant.epoch > epoch:
            toll.rewinds += 1
            toll.flown_again += max(0, furthest - start)
            epoch, furthest = grant.epoch, start
        furthest = max(furthest, min(grant.step, steps))
    toll.flights += 1
    toll.steps += steps
    toll.states += done.json["messages"]


def kill(pid: int) -> bool:
    """Kill a process, and return whether it was still there."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def end(job: Job) -> None:
    """End a node that is not needed any more."""
    if job.running:
        job.send(signal.SIGTERM)
    job.wait()


def main() -> int:
    """Torture flights and print the toll."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory, open_terminal(Path(directory)) as terminal:
        print(torture(terminal, options.seed, options.kills))
    return 0


if __name__ == "__main__":
    sys.exit(main())
