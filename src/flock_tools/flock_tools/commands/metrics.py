# SPDX-License-Identifier: Apache-2.0
"""Metrics of a recorded flock: `flock metrics RUN`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flock_sim.console.arguments import Parser, note, print_json, print_text, run_tool
from flock_tools.commands.options import add_moment_option, moment, span

if TYPE_CHECKING:
    from flock_sim.recording.message_age import Deviation
    from flock_sim.recording.run import Run

DESCRIPTION = """\
Print the metrics of a recorded flight: verdict, speeds, spacings and drag saved. The verdict says
whether the flock holds together: holds, settling, apart or stalled (docs/model.md). `stable` is the
criterion of the paper: sigma_U, the spread of the speeds, is below 1e-4 U_min.
Lengths are in b (half the standard wing span), speeds in U_min, times in b/U_min.
For a free flight, the tool also prints the age of the data that the birds used, and the deviation
from the same flight in lockstep, which it computes for the comparison."""

EXAMPLES = """\
  ./flock metrics runs/demo
  ./flock metrics runs/demo --at 500 --over 100
  ./flock metrics runs/demo --json | jq .verdict"""


def tool(arguments: Sequence[str]) -> int:
    """Compute the metrics of a run and print them."""
    parser = Parser("metrics", DESCRIPTION, EXAMPLES)
    parser.add_argument("run", metavar="RUN", type=Path, help="directory of a bag")
    add_moment_option(parser)
    parser.add_argument(
        "--over",
        metavar="T",
        help="length of the time before, over which means are taken, in b/U_min (a tenth of the "
        "time flown)",
    )
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON on stdout")
    options = parser.parse_args(arguments)
    time, over = moment(options), span(options)

    from flock_sim.analysis.summary import summary
    from flock_sim.recording.message_age import freshness
    from flock_sim.recording.own_parts import is_here, lacking
    from flock_sim.recording.run import Run

    with Run(options.run) as run:
        if run.missing:
            note(f"note: {run.missing}; its intact part is used")
        if run.own_parts:
            note(f"note: {run.path} was {lacking(run.own_parts)}")
        metrics, fresh = run.metrics(time), freshness(run)
        means, verdicts = run.time_means(metrics.t_final, over), run.verdicts(time)
        own, digest = run.own_parts, run.state_digest
        off = _deviation(run) if fresh and all(map(is_here, own)) else None
    if options.json:
        free = fresh.as_json() | {"deviation": off and off.as_json()} if fresh else {}
        parts = {"own_parts": [str(part) for part in own]}
        known = {**metrics.as_json(), **means.as_json(), **verdicts.as_json(), **free}
        print_json({**known, "state_digest": digest, **parts})
        return 0
    print_text(summary(metrics, means, verdicts))
    if fresh:
        print_text("\n".join([*fresh.told(), *(off.told() if off else [])]))
    return 0


def _deviation(run: Run) -> Deviation:
    """Return the deviation of a free flight from the lockstep flight, which is integrated here."""
    from flock_sim.console.progress import progress_bar
    from flock_sim.recording.message_age import deviation

    with progress_bar("in lockstep", run.configuration) as show:
        return deviation(run, show)


def main() -> int:
    """Run the `metrics` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
