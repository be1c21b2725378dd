# SPDX-License-Identifier: Apache-2.0
"""A valid bag from a damaged or truncated one: `flock repair RUN`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flock_sim.console.arguments import Parser, print_json, print_text, run_tool
from flock_sim.errors import FlockError

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.recording.run import Run

DESCRIPTION = """\
Write a valid bag from a damaged one: the recorder was killed, the disk was full, the end is
missing, or bytes anywhere are damaged. The new bag has all intact messages, also those after a
damaged place and those before a cut in the last chunk, a summary and metadata.yaml. Invalid
perturbations are left out. The damaged bag is not changed. ./flock fly --resume flies the steps
that the new bag lacks.
It also makes a run of a flight that another program recorded, such as ros2 bag record, live or
while it was played: with simulated times, each recorded step once. The configuration is that of the
clock's grants in the bag, or of --config.
Exit status: 0 repaired, or nothing to repair; 2 not a bag of Flock, or no intact message in it."""

EXAMPLES = """\
  ./flock repair runs/torn                        writes runs/torn-repaired
  ./flock repair runs/torn --output runs/whole --force
  ./flock repair rosbag2_2026_01_31 --output runs/theirs --config flock.yaml"""


@dataclass(frozen=True)
class Damage:
    """The damage of a bag, and its intact content."""

    missing: str | None
    """Description of what the bag lacks at its end; None: nothing."""
    broken: str | None
    """Description of the damaged places; None: all of the bag can be read."""
    cut: str | None
    """Description of the chunk that the end of the file cuts, if it has whole messages."""
    messages: int
    """Number of intact messages in the whole bag."""
    invalid: int
    """Number of perturbations among them that are invalid or have the number of another."""
    missing_steps: list[int]
    """Recorded steps that are not intact: between intact steps or, by the summary, at the end."""

    @property
    def any(self) -> bool:
        """Whether the bag needs a repair."""
        return self.missing is not None or self.broken is not None or self.invalid > 0


def examine(run: Run) -> Damage:
    """Read all of `run`, and return its damage.

    Raises FlockError if its beginning is damaged: the configuration or the list of topics.
    """
    from flock_sim.recording.flight_bag import check_grants, check_topics

    if run.bag.message_counts is None:  # else a summary with a valid CRC lists the topics
        check_topics(run.bag, run.configuration)
    check_grants(run.bag, run.configuration, run.real_time_factor)
    broken: list[str] = []
    cut: list[str] = []
    pushes, steps = _Pushes(run.configuration), _Steps(run.configuration)
    messages = invalid = 0
    for topic, _, data in run.bag.salvage(broken, cut):
        messages += 1
        invalid += not pushes.take(topic, data)
        steps.take(topic, data)
    if broken and not pushes.numbers and run.bag.last_time is not None:
        steps.end(run.bag.last_time)  # perturbations may have a later time than the last step
    return Damage(
        run.bag.missing,
        "; ".join(broken) or None,
        "; ".join(cut) or None,
        messages,
        invalid,
        steps.missing,
    )


class _Pushes:
    """Separates valid perturbations from invalid and repeated ones."""

    def __init__(self, configuration: FlockConfiguration) -> None:
        self._configuration = configuration
        self.numbers: set[int] = set()

    def take(self, topic: str, data: bytes) -> bool:
        """Return whether a message is kept in the bag."""
        from flock_sim.messages import topics
        from flock_sim.recording.flight_bag import checked_push

        if topic != topics.PERTURBATION_TOPIC:
            return True
        try:
            number = checked_push(data, self._configuration).number
        except FlockError:
            return False
        if number in self.numbers:
            return False
        self.numbers.add(number)
        return True


class _Steps:
    """Finds the missing recorded steps of a bag. It takes the messages in their order."""

    def __init__(self, configuration: FlockConfiguration) -> None:
        from flock_sim.messages import topics

        self._configuration = configuration
        self._states = {topics.state_topic(bird) for bird in range(1, configuration.birds + 1)}
        self._step = -1
        self._birds = 0
        self._next = 0
        self.missing: list[int] = []

    def take(self, topic: str, data: bytes) -> None:
        """Register a message."""
        from flock_sim.messages.types import State

        if topic not in self._states:
            return
        try:
            step = State.step_of(data)
        except ValueError:
            return
        self._birds = self._birds + 1 if step == self._step else 1
        self._step = step
        if self._birds == len(self._states):
            self._until(step)
            self._next = step + self._configuration.record_every

    def end(self, time: int) -> None:
        """Register that steps were recorded up to the simulated `time`, in ns."""
        flown = self._configuration
        last = self._next
        while last <= flown.steps and flown.stamp(last) <= time:
            last += flown.record_every
        self._until(last)

    def _until(self, step: int) -> None:
        self.missing.extend(range(self._next, step, self._configuration.record_every))


def rewrite(run: Run, output: Path, *, replace: bool = False) -> int:
    """Write the intact messages of `run` to a bag in the directory `output`.

    The directory is empty or, with `replace`, holds a bag, which may be `run`. That bag is replaced
    after all messages are written.

    Returns the number of messages that are left out because they are not on Flock's topics. Raises
    FlockError if `output` can't be written; no new bag is created then.
    """
    from flock_sim.messages import topics
    from flock_sim.recording.flight_bag import has_stages
    from flock_sim.recording.flight_writer import recording
    from flock_sim.recording.own_parts import add_parts

    grants = topics.GRANT_TOPIC in run.bag.topics
    live = topics.PERTURBATION_TOPIC in run.bag.topics
    foreign = 0
    pushes = _Pushes(run.configuration)
    with recording(
        output,
        run.configuration,
        grants=grants,
        stages=has_stages(run.bag),
        live=live,
        replace=replace,
        factor=run.real_time_factor,
        machines=run.machines,
    ) as whole:
        try:
            add_parts(whole.bag, run.own_parts)
            for topic, log_time, data in run.bag.salvage([], []):
                if pushes.take(topic, data):
                    try:
                        whole.write(topic, log_time, data)
                    except KeyError:
                        foreign += 1
            whole.bag.flush()
            whole.bag.take_place()
        except BaseException:
            whole.bag.discard()
            raise
    return foreign


def tool(arguments: Sequence[str]) -> int:
    """Repair a bag and print what it lacks."""
    parser = Parser("repair", DESCRIPTION, EXAMPLES)
    parser.add_argument("run", metavar="RUN", type=Path, help="directory of a bag, or .mcap file")
    parser.add_argument(
        "--output", metavar="DIR", type=Path, help="directory of the new bag (RUN-repaired)"
    )
    parser.add_argument(
        "--config",
        metavar="FILE",
        type=Path,
        help="configuration of a flight that another program recorded (that in its grants)",
    )
    parser.add_argument("--force", action="store_true", help="replace the bag in --output")
    parser.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    options = parser.parse_args(arguments)

    from flock_sim.recording.output_directory import own_output
    from flock_sim.recording.run import Run

    directory = options.run if options.run.is_dir() else options.run.parent
    output = options.output or _beside(directory)
    facts = _of_others(options, output)
    if facts is not None:
        _tell(facts, options.json)
        return 0
    with Run(options.run) as run:
        damage = examine(run)
        if damage.any and damage.messages == 0:
            raise FlockError(f"{run.path}: it has no intact message; fly again")
        foreign = 0
        if damage.any:
            with own_output(output, options.force) as owned:
                foreign = rewrite(run, output, replace=owned.replaces)
    facts = {
        "run": str(options.run),
        "output": str(output) if damage.any else None,
        "missing": damage.missing,
        "broken": damage.broken,
        "cut": damage.cut,
        "missing_steps": damage.missing_steps,
        "messages": damage.messages - foreign - damage.invalid,
        "left_out": foreign,
        "invalid_perturbations": damage.invalid,
    }
    _tell(facts, options.json)
    return 0


def _of_others(options: argparse.Namespace, output: Path) -> dict[str, Any] | None:
    """Make a run of a flight that another program recorded; return the result.

    Returns None if the bag has the records of Flock, or needs no more than these.
    """
    from flock_sim.bag.reading.reader import BagReader
    from flock_sim.configuration.options import flock_configuration
    from flock_sim.messages import topics
    from flock_sim.recording.foreign_flight import ForeignFlight, needed_repair, write_flight
    from flock_sim.recording.output_directory import own_output

    with BagReader(options.run) as bag:
        if not (repair := needed_repair(bag)):
            if options.config:
                raise FlockError(f"--config {options.config}: {options.run} has its configuration")
            return None
        if not options.config and topics.GRANT_TOPIC not in bag.topics:
            raise FlockError(repair)
        flight = ForeignFlight(bag, flock_configuration(options) if options.config else None)
        with own_output(output, options.force) as owned:
            rows = write_flight(flight, output, replace=owned.replaces)
        birds = flight.configuration.birds
        return {
            "run": str(options.run),
            "output": str(output),
            "missing": bag.missing,
            "broken": None,
            "cut": None,
            "missing_steps": flight.missing_steps,
            # Wings, then /clock and all states in each row, and pushes.
            "messages": birds + rows * (1 + birds) + len(flight.pushes),
            "left_out": flight.left_out,
            "invalid_perturbations": 0,
        }


def _tell(facts: Mapping[str, Any], as_json: bool) -> None:
    if as_json:
        print_json(dict(facts))
    else:
        print_text(described(facts))


def described(facts: Mapping[str, Any]) -> str:
    """Return the result as text."""
    if facts["output"] is None:
        return f"{facts['run']} is complete: nothing to repair"
    lines = [reason for reason in (facts["missing"], facts["broken"]) if reason]
    if steps := facts["missing_steps"]:
        lines.append(
            f"{len(steps)} recorded steps are missing, from step {steps[0]} to step {steps[-1]}"
        )
    if facts["invalid_perturbations"]:
        lines.append(f"{facts['invalid_perturbations']} invalid perturbations are left out")
    if facts["left_out"]:
        lines.append(f"{facts['left_out']} messages that are no part of the flight are left out")
    lines.append(f"{facts['messages']} intact messages are in {facts['output']}")
    if facts["cut"]:
        lines.append(facts["cut"])
    return "\n".join(lines)


def _beside(directory: Path) -> Path:
    """Return the directory of the new bag beside `directory`, which may be `.` or `..`."""
    whole = directory.resolve()
    return (directory if directory.name not in ("", "..") else whole).with_name(
        f"{whole.name}-repaired"
    )


def main() -> int:
    """Run the `repair` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
