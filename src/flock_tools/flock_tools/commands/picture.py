# SPDX-License-Identifier: Apache-2.0
"""A picture of a recorded flock, seen from above: `flock picture RUN`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from flock_sim.console.arguments import Parser, note, print_text, run_tool, whole_number
from flock_tools.commands.options import add_moment_option, moment
from flock_tools.figures.output import check_picture, write_picture

DESCRIPTION = """\
Draw the formation at one time, each bird coloured by the drag it saves, and below it two curves
against time: the spread of the speeds, and the spacings along the wings. Each part of a flock that
has come apart is drawn in a panel of its own, on the same scale."""

EXAMPLES = """\
  ./flock picture runs/demo                                  writes runs/demo/formation.png
  ./flock picture runs/demo --at 100 --output early.png
  ./flock picture runs/three --member 2                      writes formation_member_2.png
  ./flock picture runs/three --member 2 --output second.pdf"""


def tool(arguments: Sequence[str]) -> int:
    """Draw a run and print the path of the picture."""
    parser = Parser("picture", DESCRIPTION, EXAMPLES)
    parser.add_argument("run", metavar="RUN", type=Path, help="directory of a bag")
    add_moment_option(parser)
    parser.add_argument(
        "--member", metavar="M", default="1", help="number of the member to draw (1)"
    )
    parser.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        help="file of the picture (RUN/formation.png; of member M above 1, "
        "RUN/formation_member_M.png)",
    )
    options = parser.parse_args(arguments)
    time = moment(options)
    check_picture(options.output)

    from flock_sim.recording.run import Run
    from flock_tools.figures.run_history import draw_run

    with Run(options.run) as run:
        if run.missing:
            note(f"note: {run.missing}; its intact part is drawn")
        member = whole_number("--member", options.member, 1, run.configuration.members)
        output = _output(options, member)
        check_picture(output)
        figure = draw_run(run, time, member)
    write_picture(figure, output)
    print_text(str(output))
    return 0


def _output(options: argparse.Namespace, member: int) -> Path:
    if options.output is not None:
        return Path(options.output)
    from flock_sim.bag.directory import picture_file

    run = Path(options.run)
    return (run if run.is_dir() else run.parent) / picture_file(member)


def main() -> int:
    """Run the `picture` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
