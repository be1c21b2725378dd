# SPDX-License-Identifier: Apache-2.0
"""A proper bag from one that was cut short: `flock repair RUN`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flock_sim.bag.output import claim_output
from flock_sim.command_line import Parser, print_json, run_tool
from flock_sim.core import topics
from flock_sim.errors import FlockError
from flock_sim.recording import has_stages, recording
from flock_sim.run import Run

DESCRIPTION = """\
Write a proper bag from one whose recorder was killed, whose disk was full or whose end was torn
off: with all messages that are whole, a summary and metadata.yaml. The old bag is left as it is.
Exit status: 0 repaired, or nothing to repair; 2 no bag of Flock's, or no whole message in it."""

EXAMPLES = """\
  ./flock repair runs/torn                        writes runs/torn-repaired
  ./flock repair runs/torn --output runs/whole --force"""


@dataclass(frozen=True)
class Damage:
    """What is wrong with a bag, and what is whole of it."""

    missing: str | None
    """What the bag lacks at its end; None: nothing."""
    broken: str | None
    """Why no more of it can be read than is whole; None: it can be read to its end."""
    messages: int
    """Messages that are whole, up to where it is broken."""


def examine(run: Run) -> Damage:
    """Read all of `run`, and say what is wrong with it."""
    broken: list[str] = []
    messages = sum(1 for _ in _until_broken(run, broken))
    return Damage(run.bag.missing, broken[0] if broken else None, messages)


def rewrite(run: Run, output: Path) -> int:
    """Write the whole messages of `run` to a bag in the empty directory `output`.

    Returns how many are left out, since they are not on Flock's topics. Raises FlockError where
    `output` can't be written.
    """
    grants = topics.GRANT_TOPIC in run.bag.topics
    live = topics.PERTURBATION_TOPIC in run.bag.topics
    stages = has_stages(run.bag)
    foreign = 0
    with recording(
        output,
        run.configuration,
        grants=grants,
        stages=stages,
        live=live,
        factor=run.real_time_factor,
    ) as whole:
        for topic, log_time, data in _until_broken(run, []):
            try:
                whole.bag.write(topic, log_time, data)
            except KeyError:
                foreign += 1
    return foreign


def _until_broken(run: Run, broken: list[str]) -> Iterator[tuple[str, int, bytes]]:
    """Yield messages; where a chunk is damaged, end and add the reason to `broken`."""
    try:
        yield from run.bag.messages()
    except FlockError as error:
        broken.append(str(error))


def tool(arguments: Sequence[str]) -> int:
    """Repair a bag and say what it lacks."""
    parser = Parser("repair", DESCRIPTION, EXAMPLES)
    parser.add_argument("run", metavar="RUN", type=Path, help="directory of a bag, or .mcap file")
    parser.add_argument(
        "--output", metavar="DIR", type=Path, help="directory of the new bag (RUN-repaired)"
    )
    parser.add_argument("--force", action="store_true", help="replace the bag in --output")
    parser.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    options = parser.parse_args(arguments)
    directory = options.run if options.run.is_dir() else options.run.parent
    output = options.output or directory.with_name(f"{directory.resolve().name}-repaired")
    with Run(options.run) as run:
        damage = examine(run)
        needed = damage.missing is not None or damage.broken is not None
        if needed and damage.messages == 0:
            raise FlockError(f"{run.path}: no message of it is whole; fly again")
        foreign = 0
        if needed:
            claim_output(output, options.force)
            foreign = rewrite(run, output)
    facts = {
        "run": str(options.run),
        "output": str(output) if needed else None,
        "missing": damage.missing,
        "broken": damage.broken,
        "messages": damage.messages - foreign,
        "left_out": foreign,
    }
    if options.json:
        print_json(facts)
    else:
        print(described(facts))
    return 0


def described(facts: Mapping[str, Any]) -> str:
    """Return the result as people read it."""
    if facts["output"] is None:
        return f"{facts['run']} is complete: nothing to repair"
    lines = [reason for reason in (facts["missing"], facts["broken"]) if reason]
    lines.append(f"{facts['messages']} messages are whole, and in {facts['output']}")
    if facts["left_out"]:
        lines.append(f"{facts['left_out']} messages on topics that are not Flock's are left out")
    return "\n".join(lines)


def main() -> int:
    """Run the `repair` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
