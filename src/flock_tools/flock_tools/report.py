# SPDX-License-Identifier: Apache-2.0
"""A page on recorded runs that opens anywhere: `flock report RUN [RUN ...]`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from flock_sim.bag.output import REPORT_FILE
from flock_sim.command_line import Parser, note, print_json, run_tool
from flock_sim.core.metrics import plain
from flock_sim.errors import FlockError
from flock_sim.progress import counter
from flock_sim.run import Run
from flock_tools.output_file import check_output, write_output
from flock_tools.report_data import Reported, Room, reported
from flock_tools.report_numbers import key_numbers
from flock_tools.report_page import page

ENDINGS = (".html", ".htm")

DESCRIPTION = """\
Write a page on one or several runs of as many birds: verdict and key numbers, the formation in
motion, speeds, spacings and drag saved against time, the final spacings against theory,
eigenvalues, configuration and provenance. One HTML file that needs no network."""

EXAMPLES = """\
  ./flock report runs/demo                                   writes runs/demo/report.html
  ./flock report runs/demo runs/late --output both.html      two runs, compared
  ./flock report runs/demo --json | jq .output"""


def tool(arguments: Sequence[str]) -> int:
    """Write a report and say where it is."""
    parser = Parser("report", DESCRIPTION, EXAMPLES)
    parser.add_argument("runs", metavar="RUN", nargs="+", type=Path, help="directory of a bag")
    parser.add_argument(
        "--output", metavar="FILE", type=Path, help="the page (report.html in the first RUN)"
    )
    parser.add_argument(
        "--json", action="store_true", help="print where it is and the key numbers as JSON"
    )
    options = parser.parse_args(arguments)
    with ExitStack() as stack:
        runs = [stack.enter_context(Run(path)) for path in options.runs]
        _check_birds(runs)
        output = _output(options)
        for run in runs:
            if run.missing:
                note(f"note: {run.missing}; what is whole of it is shown")
        shown = _read(runs)
    content = page(shown)
    write_output(output, content)
    if options.json:
        numbers = [{k: plain(v) for k, v in key_numbers(run).items()} for run in shown]
        print_json({"output": str(output), "bytes": len(content), "runs": numbers})
    else:
        print(output)
    return 0


def _read(runs: Sequence[Run]) -> list[Reported]:
    room = Room.of([run.configuration for run in runs])
    last = [run.at().step // run.configuration.record_every for run in runs]
    with counter("reading", "rows", sum(last) + len(last)) as show:
        return [
            reported(run, room, members, show)
            for run, members in zip(runs, room.members, strict=True)
        ]


def _check_birds(runs: Sequence[Run]) -> None:
    """Refuse runs that can't be laid over each other."""
    first = runs[0].configuration.birds
    for run in runs[1:]:
        birds = run.configuration.birds
        if birds != first:
            raise FlockError(
                f"{run.path} has {birds} bird{'s' * (birds > 1)} and {runs[0].path} has {first}: "
                "runs in one report must be of as many birds; write one report for each"
            )


def _output(options: argparse.Namespace) -> Path:
    """Return the file to write. Raises FlockError where it can't be, or may be another thing."""
    output = options.output
    if output is None:
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
