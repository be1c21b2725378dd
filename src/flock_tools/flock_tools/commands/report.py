# SPDX-License-Identifier: Apache-2.0
"""A self-contained HTML page on recorded runs: `flock report RUN [RUN ...]`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.console.arguments import Parser, note, print_json, print_text, run_tool
from flock_sim.errors import FlockError
from flock_tools.figures.output import check_output, write_output

if TYPE_CHECKING:
    from flock_sim.recording.run import Run
    from flock_tools.report.data import Reported

ENDINGS = (".html", ".htm")

DESCRIPTION = """\
Write a page on one or more runs with equal numbers of birds: verdict, key numbers, the formation in
motion, speeds, spacings and drag saved against time, the final spacings against theory,
eigenvalues, configuration and provenance. One HTML file that needs no network."""

EXAMPLES = """\
  ./flock report runs/demo                                   writes runs/demo/report.html
  ./flock report runs/demo runs/late --output both.html      two runs, compared
  ./flock report runs/demo --json | jq .output"""


def tool(arguments: Sequence[str]) -> int:
    """Write a report and print its path."""
    parser = Parser("report", DESCRIPTION, EXAMPLES)
    parser.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="directory of a bag")
    parser.add_argument(
        "--output", metavar="FILE", type=Path, help="the page (report.html in the first RUN)"
    )
    parser.add_argument(
        "--json", action="store_true", help="print the path and the key numbers as JSON on stdout"
    )
    options = parser.parse_args(arguments)

    from flock_sim.recording.run import Run

    with ExitStack() as stack:
        runs = [stack.enter_context(Run(path)) for path in options.runs]
        _check_birds(runs)
        output = _output(options)
        for run in runs:
            if run.missing:
                note(f"note: {run.missing}; its intact part is shown")
        shown = _read(runs)

    from flock_tools.report.html import page

    content = page(shown)
    write_output(output, content)
    if options.json:
        from flock_sim.analysis.metrics import plain
        from flock_tools.report.key_numbers import key_numbers

        numbers = [{k: plain(v) for k, v in key_numbers(run).items()} for run in shown]
        print_json({"output": str(output), "bytes": len(content), "runs": numbers})
    else:
        print_text(str(output))
    return 0


def _read(runs: Sequence[Run]) -> list[Reported]:
    from flock_sim.console.progress import counter
    from flock_tools.report.data import Room, reported

    room = Room.of([run.configuration for run in runs])
    last = [run.at().step // run.configuration.record_every for run in runs]
    with counter("reading", "rows", sum(last) + len(last)) as show:
        return [
            reported(run, room, members, show)
            for run, members in zip(runs, room.members, strict=True)
        ]


def _check_birds(runs: Sequence[Run]) -> None:
    """Raise FlockError unless all runs have the same number of birds."""
    first = runs[0].configuration.birds
    for run in runs[1:]:
        birds = run.configuration.birds
        if birds != first:
            raise FlockError(
                f"{run.path} has {birds} bird{'s' * (birds > 1)} and {runs[0].path} has {first}: "
                "runs in one report must have the same number of birds; write one report for each"
            )


def _output(options: argparse.Namespace) -> Path:
    """Return the output file. Raises FlockError if it can't be written or is not named as HTML."""
    output = options.output
    if output is None:
        from flock_sim.bag.directory import REPORT_FILE

        run = options.runs[0]
        output = (run if run.is_dir() else run.parent) / REPORT_FILE
    elif output.suffix.lower() not in ENDINGS:
        raise FlockError(f"--output {output}: must end in one of {', '.join(ENDINGS)}")
    check_output(output)
    return Path(output)


def main() -> int:
    """Run the `report` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
