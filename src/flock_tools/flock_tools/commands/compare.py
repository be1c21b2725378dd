# SPDX-License-Identifier: Apache-2.0
"""Whether two recorded runs are the same flight: `flock compare RUN RUN`."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.console.arguments import (
    Parser,
    note,
    print_json,
    print_text,
    run_tool,
)
from flock_sim.errors import FlockError
from flock_sim.outside.printing import shown

if TYPE_CHECKING:
    from flock_sim.recording.run import Run
    from flock_tools.runs.comparison import Comparison
    from flock_tools.runs.difference import Difference

DIFFERENT = 1
"""Exit status if the runs are not equal."""

LONG = 1_000_000
"""Number of state messages from which on a comparison shows its progress."""

MOST_WINGS = 4
"""Largest number of different wings that are listed."""

DESCRIPTION = """\
Compare two recorded flights: every field of every state message, the wings and the configuration.
Data on how the flights were operated (run ids, grants, clock, diagnostics) are not compared.
Perturbations in flight are not compared either: the states show their effect.
Exit status: 0 equal, 1 not equal, 2 bad input."""

EXAMPLES = """\
  ./flock compare runs/demo runs/reference                    bit for bit
  ./flock compare runs/demo runs/reference --tolerance 1e-12
  ./flock compare runs/demo runs/reference --json | jq .max_difference"""


def tool(arguments: Sequence[str]) -> int:
    """Compare two runs and print the result."""
    parser = Parser("compare", DESCRIPTION, EXAMPLES)
    parser.add_argument("runs", metavar="RUN", nargs=2, type=Path, help="directory of a bag")
    parser.add_argument(
        "--tolerance",
        metavar="X",
        help="largest absolute difference, in dimensionless units, of position, speed, circulation "
        "and interaction drag that counts as equal (without it: equal bit for bit)",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    options = parser.parse_args(arguments)
    tolerance = None if options.tolerance is None else _tolerance(options.tolerance)

    from flock_sim.recording.own_parts import lacking
    from flock_sim.recording.run import Run
    from flock_tools.runs.comparison import compare

    with Run(options.runs[0]) as first, Run(options.runs[1]) as second:
        for run in (first, second):
            if run.missing:
                note(f"note: {run.missing}; its intact part is compared")
            if run.real_time_factor:
                note(f"note: {run.path} was flown freely: no other flight is equal to it")
            if run.own_parts:
                note(f"note: {run.path} was {lacking(run.own_parts)}")
        with _progress(first) as show:
            result = compare(first, second, tolerance, show)
        if options.json:
            print_json({**result.as_json(), **_origin_json((first, second))})
        else:
            print_text(told(result, first, second, tolerance))
            print_text("\n".join(_origins((first, second))))
    return 0 if result.equal else DIFFERENT


def told(result: Comparison, first: Run, second: Run, tolerance: float | None) -> str:
    """Return the result as text."""
    how = "bit for bit" if tolerance is None else f"to within {tolerance:g}"
    if result.equal:
        gap = max(result.max_difference.values())
        largest = f", largest difference {gap:.3g}" if tolerance is not None else ""
        return f"equal {how}: {result.messages} state messages{largest}"
    lines = [f"not equal {how}: {first.path} and {second.path}"]
    lines += [f"  {difference.field}: {_values(difference)}" for difference in result.configuration]
    shown = result.wings[:MOST_WINGS]
    lines += [f"  wing of bird {wing.bird}: {_values(wing)}" for wing in shown]
    if len(shown) < len(result.wings):
        lines.append(f"  ... and {len(result.wings) - len(shown)} more wings")
    if result.state is not None:
        lines.append(f"  the first difference is at {_place(result.state)}: {_state(result.state)}")
    if result.different and not result.comparable:
        flocks = f"{first.configuration.members} and {second.configuration.members}"
        lines.append(f"  no values are compared: the runs have {flocks} members")
    elif result.different:
        gaps = ", ".join(f"{name} {gap:.3g}" for name, gap in result.max_difference.items())
        lines.append(f"  {result.different} of {result.messages} state messages differ")
        lines.append(f"  largest differences: {gaps}")
    for run, missing in zip((first, second), result.missing, strict=True):
        if missing:
            lines.append(f"  {run.path} lacks {missing} state messages, {_end(run)}")
    return "\n".join(lines)


def _origins(runs: Sequence[Run]) -> Iterator[str]:
    """Yield a line for each run: the digest in it, its machines and how they differ."""
    from flock_sim.recording.machine import differing

    differences = differing(machine for run in runs for machine in run.machines)
    for run in runs:
        digest = run.state_digest or "no digest of its states"
        facts = ("processor", "c_library", *differences)
        machines = "; ".join(machine.told(*facts) for machine in run.machines)
        yield f"  {run.path}: {digest}, recorded on {machines or 'an unknown machine'}"


def _origin_json(runs: Sequence[Run]) -> dict[str, object]:
    """Return for each run the digest in it and its machines; None for bags without."""
    machines = [[asdict(machine) for machine in run.machines] or None for run in runs]
    return {"digests": [run.state_digest for run in runs], "machines": machines}


def _place(difference: Difference) -> str:
    where = f"step {difference.step} (t = {difference.time:g}), bird {difference.bird}"
    return where if difference.member is None else f"{where}, member {difference.member}"


def _state(difference: Difference) -> str:
    if difference.kind == "missing":
        return f"only the {'first' if difference.values[0] else 'second'} run has this state"
    return f"{difference.field} {_values(difference)}"


def _values(difference: Difference) -> str:
    first, second = difference.values
    gap, bits = difference.distance, difference.bits
    if isinstance(first, list) and isinstance(second, list) and difference.kind == "state":
        return f"of {len(first)} and {len(second)} members"
    if gap is None or bits is None:
        return f"{first} and {second}"
    if gap > 0.0:
        return f"{first!r} and {second!r}, {gap:.3g} apart"
    # Equal numbers of different bits: -0.0 and 0.0, or two kinds of nan.
    return f"{first!r} and {second!r}, in bits {bits[0]} and {bits[1]}"


def _end(run: Run) -> str:
    try:
        return f"its last complete step is {run.at().step}"
    except FlockError:
        return "it has no complete step"


def _progress(run: Run) -> AbstractContextManager[Callable[[int], None]]:
    counts = run.bag.message_counts
    if counts is None or sum(counts.values()) < LONG:
        return nullcontext(lambda step: None)
    from flock_sim.console.progress import progress_bar

    return progress_bar("comparing", run.configuration)


def _tolerance(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise FlockError(f"--tolerance {shown(text)}: must be a finite number, 0 or more")
    return value


def main() -> int:
    """Run the `compare` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
