# SPDX-License-Identifier: Apache-2.0
"""The best order of unequal birds: `flock arrange`."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from flock_sim.configuration.options import (
    add_config_option,
    add_flock_option,
    flock_configuration,
)
from flock_sim.console.arguments import (
    Parser,
    print_json,
    print_text,
    run_tool,
)
from flock_sim.errors import FlockError
from flock_sim.outside.printing import shown
from flock_tools.commands.options import add_picture_options, check_links_exact, check_unforced
from flock_tools.figures.output import check_picture, write_picture

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.theory.arrangement.arrange import Arranged, Arrangement

MOST_BIRDS = {"nearest": 60, "all": 25}
"""Largest flock of each coupling: about a minute of the local search."""

SMALLEST, LARGEST = 0.01, 100.0
"""Span ratios that are accepted."""

MOST_DIGITS = 10**15
"""Number of orders from which on three digits are printed."""

EXAMPLE = "0.96,0.98,1,1.02,1.04"

NAMES = {
    "fastest": "fastest",
    "fastest_flying": "fastest that flies",
    "firmest": "firmest",
    "closest": "closest to flying",
}
"""The results, and their names in the table."""

DESCRIPTION = f"""\
Find the best order of birds of unequal span: the fastest order, the fastest order that can fly in
formation, and the firmest order, which has the largest margin. For the margin, take the share of a
set of birds in the drag saved between this set and the other birds. The margin is the smallest
distance of such a share from 0 or 1, over all sets.
An order and its mirror image are the same; the smaller end is printed first. If orders differ by
rounding only (1e-12), the lexicographically smallest one is printed. Two birds whose span ratios
sum to 1 or less can't be neighbours.
The search has three methods:
  Up to 2,000,000 orders (10 different birds): all are computed, and those that can fly are counted.
  The method is called "exact".
  More orders, nearest-neighbour coupling, up to 17 different birds or more if some are equal:
  branch and bound, which proves that no order is better. The method is called "exact", too.
  All other flocks, and those whose proof takes more than two minutes: a heuristic, which may not
  find the best order. The method is called "local search".
In JSON, `flying` is null if orders are not counted, and a result is null if there is none.
Number of birds: 2 to {MOST_BIRDS["nearest"]}, with all-to-all coupling {MOST_BIRDS["all"]}.
Exit status: 0, whether an order can fly or not; 2 bad input."""

EXAMPLES = f"""\
  ./flock arrange --spans {EXAMPLE}
  ./flock arrange --spans 0.97,0.97,0.98,1,1,1.01,1.01,1.02,1.03 --output orders.png
  ./flock arrange --spans {EXAMPLE} --coupling all --json | jq .firmest.order"""


def tool(arguments: Sequence[str]) -> int:
    """Find the best orders and print them."""
    options = _parser().parse_args(arguments)
    configuration = _flock(options)
    spans = _spans(options.spans, configuration.coupling)
    check_picture(options.output)

    import numpy as np

    from flock_sim.console.progress import stages
    from flock_sim.launcher.precompile import warm_equilibrium
    from flock_sim.theory.arrangement.arrange import arrange

    warm_equilibrium(configuration.coupling)
    begun = time.perf_counter()
    with stages() as show:
        found = arrange(configuration, np.array(spans), show)
    seconds = time.perf_counter() - begun
    if options.json:
        print_json(as_json(found, seconds))
    else:
        print_text(described(found, configuration, seconds))
    if options.output is not None:
        from flock_tools.figures.arrangement import draw_arrangement  # matplotlib takes 0.5 s

        write_picture(draw_arrangement(found), options.output)
        if not options.json:
            print_text(f"drawn: {options.output}")
    return 0


def _parser() -> Parser:
    parser = Parser("arrange", DESCRIPTION, EXAMPLES)
    flock = parser.add_argument_group("flock")
    flock.add_argument(
        "--spans",
        metavar="L1,L2,...",
        required=True,
        help="wing spans of all birds over the standard span, in any order; their number replaces "
        "`birds` of the file",
    )
    add_flock_option(flock, "coupling")
    add_config_option(flock)
    add_picture_options(parser, "file for a picture of the orders")
    return parser


def as_json(found: Arrangement, seconds: float) -> dict[str, Any]:
    """Return all results as plain values."""
    from flock_sim.analysis.metrics import plain

    def one(result: Arranged | None) -> dict[str, Any] | None:
        if result is None:
            return None
        facts = {
            "order": result.order,
            "speed": result.speed,
            "margin": result.margin,
            "flies": result.flies,
            "drag_reduction": result.saving,
            "proven": result.proven,
        }
        return {name: plain(value) for name, value in facts.items()}

    kinds = found.kinds
    return {
        "birds": kinds.birds,
        "coupling": kinds.coupling,
        "spans": [ratio for ratio, count in zip(*_kinds(found)) for _ in range(count)],
        "method": found.method,
        "algorithm": found.algorithm,
        "orders": found.orders,
        "flying": found.flying,
        **{name: one(getattr(found, name)) for name in NAMES},
        "seconds": seconds,
    }


def described(found: Arrangement, configuration: FlockConfiguration, seconds: float) -> str:
    """Return the result as text."""
    kinds = found.kinds
    count = f"{found.orders:,}" if found.orders < MOST_DIGITS else f"{float(found.orders):.3g}"
    orders = f"{count} order{'s' * (found.orders > 1)}"
    if found.flying is not None:
        flying = f"{found.flying:,}" if found.flying else "none"
        orders += f", {flying} can fly in formation"
    lines = [f"{kinds.birds} birds, {kinds.coupling} coupling: {orders}"]
    shown_results = {
        NAMES[name]: result for name in NAMES if (result := getattr(found, name)) is not None
    }
    if not shown_results:
        return "\n".join([*lines, f"  {_none(found)}"])
    lines.append(
        f"  {'':18}  {'U* (U_min)':>11}  {'margin':>9}  {'saving':>7}   order (span ratios)"
    )
    lines += [_row(name, result) for name, result in shown_results.items()]
    lines += [f"  {line}" for line in _meaning(found, configuration)]
    return "\n".join([*lines, f"  {_method(found)}; {seconds:.2f} s"])


def _row(name: str, result: Arranged) -> str:
    saving = f"{100.0 * result.saving:5.2f} %" if result.flies else "-"
    order = " ".join(f"{ratio:g}" for ratio in result.order)
    return f"  {name:18}  {result.speed:11.8f}  {result.margin:9.5f}  {saving:>7}   {order}"


def _meaning(found: Arrangement, configuration: FlockConfiguration) -> list[str]:
    """Return what the results mean for these birds."""
    fastest, flying, firmest = found.fastest, found.fastest_flying, found.firmest
    assert fastest is not None
    if flying is None or firmest is None:
        certain = found.method == "exact"
        told = "No order can fly in formation" if certain else "No order that can fly was found"
        return [f"{told}: the margin of every order {'is' if certain else 'tried is'} 0 or less."]
    if fastest.order.tolist() == firmest.order.tolist():
        return ["The fastest order is the firmest, too."]
    metres = configuration.min_drag_speed
    lines = []
    if fastest.flies:
        lines.append("The fastest order can fly in formation.")
    else:
        lost = metres * (fastest.speed - flying.speed)
        lines.append(
            f"The fastest order can't fly in formation. To stay together costs {lost:.3g} m/s."
        )
    lost = metres * (flying.speed - firmest.speed)
    if firmest.order.tolist() == flying.order.tolist():
        lines.append("The fastest order that flies is the firmest, too.")
    else:
        lines.append(f"The firmest is {lost:.3g} m/s slower than the fastest that flies.")
    return lines


def _method(found: Arrangement) -> str:
    if found.algorithm == "all orders":
        return "exact: all orders were computed"
    if found.method == "exact":
        return "exact: branch and bound proves that no order is better"
    if found.algorithm == "local search":
        return "a heuristic, local search: other orders may be better"
    unproven = [NAMES[name] for name in NAMES if (one := getattr(found, name)) and not one.proven]
    return f"{', '.join(unproven)}: by local search, since the proof takes too long; may be better"


def _none(found: Arrangement) -> str:
    least = sum(sorted(ratio for ratio, count in zip(*_kinds(found)) for _ in range(count))[:2])
    if least <= 1.0:
        return (
            "In no order does the thrust balance the drag at any speed, with birds next to each "
            "other whose spans sum to more than 1."
        )
    return "In no order does the thrust balance the drag at any speed."


def _kinds(found: Arrangement) -> tuple[list[float], list[int]]:
    return found.kinds.ratio.tolist(), found.kinds.count.tolist()


def _flock(options: argparse.Namespace) -> FlockConfiguration:
    configuration = flock_configuration(options)
    if configuration.span_ratios:
        raise FlockError(
            f"span_ratios in configuration file {options.config}: arrange has those of --spans; "
            "leave the key out"
        )
    check_links_exact(configuration, "arrange")
    check_unforced(configuration, "arrange")
    return replace(configuration, perturbations=(), links=())


def _spans(text: str, coupling: str) -> list[float]:
    """Return the span ratios in `text`. Raises FlockError on a number or a value out of range."""
    parts = [part.strip() for part in text.split(",")]
    most = MOST_BIRDS[coupling]
    if not 2 <= len(parts) <= most:
        raise FlockError(
            f"--spans {shown(text)!r}: has {len(parts)} value{'s' * (len(parts) != 1)}; must have "
            f"2 to {most} span ratios with {coupling} coupling, such as {EXAMPLE}"
        )
    spans = []
    for part in parts:
        try:
            span = float(part)
        except ValueError:
            span = math.nan
        if not SMALLEST <= span <= LARGEST:
            raise FlockError(
                f"--spans {shown(text)!r}: {shown(part)!r} must be a span ratio from {SMALLEST:g} "
                f"to {LARGEST:g}, such as {EXAMPLE}"
            )
        spans.append(span)
    return spans


def main() -> int:
    """Run the `arrange` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
