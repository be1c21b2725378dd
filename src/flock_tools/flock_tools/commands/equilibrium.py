# SPDX-License-Identifier: Apache-2.0
"""The steady state of a flock, without flying it: `flock equilibrium`."""

from __future__ import annotations

import cmath
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from flock_sim.configuration.options import FLIGHT, add_flock_options, flock_configuration
from flock_sim.console.arguments import Parser, print_json, print_text, run_tool

if TYPE_CHECKING:
    from flock_tools.runs.assessment import Assessment

DESCRIPTION = """\
Solve for the steady state of a flock. If it exists, the flock can fly in formation, and the tool
prints speed, spacings, drag saved and stability; if not, it prints which gap opens and which birds
stay together. The solution is exact for nearest-neighbour coupling.
Lengths are in b (half the standard wing span), speeds in U_min, times in b/U_min.
The flock is not flown: links are exact, and there is no forcing.
Exit status: 0, whether the flock can fly in formation or not; 2 bad input."""

EXAMPLES = """\
  ./flock equilibrium --birds 13
  ./flock equilibrium --span-ratio 4=0.95,1.0,1.08 --coupling all
  ./flock equilibrium --birds 31 --json | jq '.spacing[0]'"""


def tool(arguments: Sequence[str]) -> int:
    """Solve for the steady state of a flock and print it."""
    parser = Parser("equilibrium", DESCRIPTION, EXAMPLES)
    add_flock_options(parser, FLIGHT, refused=("links", "forcing"))
    parser.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    options = parser.parse_args(arguments)

    from flock_tools.commands.options import check_links_exact, check_unforced
    from flock_tools.runs.assessment import Assessment

    configuration = flock_configuration(options)
    check_links_exact(configuration, "equilibrium")
    check_unforced(configuration, "equilibrium")
    assessment = Assessment.of(configuration)
    if options.json:
        print_json(assessment.as_json())
    else:
        print_text(described(assessment))
    return 0


def described(assessment: Assessment) -> str:
    """Return the result as text."""
    from flock_sim.analysis.summary import MOST_MEMBERS

    configuration = assessment.configuration
    birds, members = configuration.birds, configuration.members
    flock = f"{birds} bird{'s' * (birds > 1)}, {configuration.coupling} coupling"
    lines = [flock + (f", {members} members" if members > 1 else "")]
    for m in range(min(members, MOST_MEMBERS)):
        lines += ["", f"member {m + 1}"] if members > 1 else []
        lines += _formation(assessment, m) if assessment.state.exists[m] else _none(assessment, m)
    if members > MOST_MEMBERS:
        lines += ["", f"... and {members - MOST_MEMBERS} members more"]
    if members > 1:
        count = int(assessment.state.exists.sum())
        lines += ["", f"{count} of {members} members can fly{' in formation' * (birds > 1)}"]
    return "\n".join(lines)


def birds_told(birds: Sequence[int]) -> str:
    """Return the birds as text, such as "bird 3" or "birds 1 to 4 and 7"."""
    runs: list[list[int]] = []
    for bird in birds:
        if runs and bird == runs[-1][-1] + 1:
            runs[-1].append(bird)
        else:
            runs.append([bird])
    texts = [
        f"{run[0]} to {run[-1]}" if len(run) > 2 else " and ".join(map(str, run)) for run in runs
    ]
    listed = " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)
    return f"bird{'s' * (len(birds) > 1)} {listed}"


def _formation(assessment: Assessment, m: int) -> list[str]:
    from flock_sim.analysis.summary import row, wings
    from flock_sim.physics import formation

    state, birds = assessment.state, assessment.configuration.birds
    leading = assessment.leading_eigenvalue[m]
    stable = {True: "stable", False: "unstable", None: "stability not computed: too many birds"}[
        assessment.stable[m]
    ]
    metres = state.speed[m] * assessment.configuration.min_drag_speed
    lines = [
        f"  verdict              can fly in formation, {stable}"
        if birds > 1
        else f"  verdict              flies alone, {stable}",
        f"  speed U*             {state.speed[m]:.9f} U_min ({metres:.2f} m/s)",
        f"  mean drag reduction  {100.0 * state.drag_reduction[:, m].mean():.2f} %",
    ]
    if birds > 1:
        lines += wings(state.spacing[:, m], state.drag_reduction[:, m], formation.leader(birds))
        lines += row("share D/C", state.share[:, m], 4, "(gap 1, 2, ...)")
        lines.append(_weakest(assessment, m))
    if cmath.isnan(leading):
        return lines
    if leading.real == 0.0:
        return [*lines, "  leading eigenvalue   0: a disturbance neither decays nor grows"]
    what = "decays" if leading.real < 0.0 else "grows"
    swing = f", with a period of {2.0 * math.pi / abs(leading.imag):.4g}" if leading.imag else ""
    return [
        *lines,
        f"  leading eigenvalue   {leading.real:.5e}"
        + (f" +- {abs(leading.imag):.5e} i" if leading.imag else ""),
        f"  a disturbance        {what} e-fold in {1.0 / abs(leading.real):.4g}{swing} b/U_min",
    ]


def _weakest(assessment: Assessment, m: int) -> str:
    """Return the line on the set of birds that is nearest to parting from the others."""
    state, gap = assessment.state, assessment.weakest_gap[m]
    margin = f"margin {state.margin[m]:.4g}"
    if not gap:
        return f"  weakest set          {_parting(assessment, m)} first: {margin}"
    share = f"share {state.share[gap - 1, m]:.4f}"
    return f"  weakest gap          {gap}, between {birds_told([gap, gap + 1])}: {share}, {margin}"


def _parting(assessment: Assessment, m: int) -> str:
    """Return how the worst set parts from the others; the smaller of both is named."""
    behind = assessment.worst_set[m]
    others = [bird for bird in range(1, assessment.configuration.birds + 1) if bird not in behind]
    named, verb = (behind, "fall") if len(behind) <= len(others) else (others, "get")
    plural = "" if len(named) > 1 else "s"
    where = "behind" if named is behind else "ahead of"
    return f"{birds_told(named)} {verb}{plural} {where} the others"


def _none(assessment: Assessment, m: int) -> list[str]:
    state, groups, gap = assessment.state, assessment.parts[m], assessment.weakest_gap[m]
    if not groups:
        what = "no formation: at no speed does the thrust balance the drag"
        if assessment.configuration.birds == 1:
            what = "can't fly: at no speed does its thrust balance its drag"
        return [f"  verdict              {what}"]
    from flock_sim.analysis.summary import row

    opens = f"gap {gap} opens, between {birds_told([gap, gap + 1])}"
    lines = [
        f"  verdict              no formation: {opens if gap else _parting(assessment, m)}",
        "  parts, fastest first " + "; ".join(birds_told(group) for group in groups),
        f"  margin               {state.margin[m]:.4g}",
    ]
    return lines + row("share D/C needed", state.share[:, m], 4, "(gap 1, 2, ...)")


def main() -> int:
    """Run the `equilibrium` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
