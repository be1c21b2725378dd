# SPDX-License-Identifier: Apache-2.0
"""Flocks in which every bird differs: `flock survey`."""

from __future__ import annotations

import argparse
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
    numbers,
    print_json,
    print_text,
    run_tool,
    whole_number,
    whole_numbers,
)
from flock_sim.errors import FlockError
from flock_sim.outside.printing import shown
from flock_tools.commands.options import (
    add_picture_options,
    add_scheduler_option,
    check_links_exact,
    check_unforced,
    two_numbers,
)
from flock_tools.figures.output import check_picture, write_picture

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_tools.experiments.random_flocks import Distribution, Population

SIZES = "3,7,13,31"
SPREADS = "0.0025,0.005,0.0075,0.01,0.015,0.02,0.03,0.04,0.06"
SAMPLES = "10000"

DESCRIPTION = """\
Generate random flocks whose birds have different span ratios, and count how many can fly in
formation. The result is their fraction against the spread of span ratios, with 95 % confidence
intervals, and the fraction of flocks that can't, for each position of the smallest bird, from the
tail to the leader. The same seed gives the same flocks, on any number of workers."""

EXAMPLES = """\
  ./flock survey --output survey.png
  ./flock survey --birds 13 --spread 0.01,0.02 --samples 100000 --seed 7
  ./flock survey --birds 5,7 --uniform 0.9,1.1 --coupling all --json"""


def tool(arguments: Sequence[str]) -> int:
    """Draw random flocks, solve for their steady states, and print the fraction that has one."""
    options = _parser().parse_args(arguments)
    flocks = _flocks(options)
    distributions = _distributions(options)
    samples = whole_number("--samples", options.samples, 1)
    seed = whole_number("--seed", options.seed, 0, 2**128 - 1)
    check_picture(options.output)

    from flock_sim.console.progress import counter
    from flock_sim.launcher.precompile import warm_equilibrium
    from flock_tools.experiments.random_flocks import survey
    from flock_tools.experiments.workers import workers

    warm_equilibrium(flocks[0].coupling)
    kinds = [(flock, distribution) for flock in flocks for distribution in distributions]
    begun = time.perf_counter()
    with (
        workers(options.scheduler) as pool,
        counter("solving", "flocks", len(kinds) * samples) as show,
    ):
        populations = [
            survey(flock, distribution, samples, seed, pool, show) for flock, distribution in kinds
        ]
        seconds = time.perf_counter() - begun
    flocks_solved = len(kinds) * samples
    how = {
        "coupling": flocks[0].coupling,
        "seed": seed,
        "flocks": flocks_solved,
        "seconds": seconds,
        "flocks_per_second": flocks_solved / seconds,
        "workers": pool.count,
    }
    if options.json:
        print_json({**how, "results": [population.as_json() for population in populations]})
    else:
        print_text(described(populations, how))
    if options.output is not None:
        from flock_tools.figures.survey import draw_survey  # matplotlib takes 0.5 s to import

        write_picture(draw_survey(populations, flocks[0].coupling), options.output)
        if not options.json:
            print_text(f"drawn: {options.output}")
    return 0


def _parser() -> Parser:
    parser = Parser("survey", DESCRIPTION, EXAMPLES)
    drawn = parser.add_argument_group("survey")
    add_config_option(drawn)
    drawn.add_argument("--birds", metavar="N[,N...]", help=f"numbers of birds ({SIZES})")
    add_flock_option(drawn, "coupling")
    which = drawn.add_mutually_exclusive_group()
    which.add_argument(
        "--spread",
        metavar="S[,S...]",
        default=SPREADS,
        help=f"standard deviations of span ratios, normal about 1 ({SPREADS})",
    )
    which.add_argument(
        "--uniform", metavar="LO,HI", help="a uniform distribution of span ratios instead"
    )
    drawn.add_argument(
        "--samples",
        metavar="K",
        default=SAMPLES,
        help=f"flocks per size and distribution ({SAMPLES})",
    )
    drawn.add_argument("--seed", metavar="SEED", default="0", help="seed of the random numbers (0)")
    add_scheduler_option(drawn, "computes")
    add_picture_options(parser, "file for a picture of the result")
    return parser


def described(populations: Sequence[Population], how: dict[str, Any]) -> str:
    """Return the result as text."""
    between = populations[0].distribution.between
    kind = f"uniform from {between[0]:g} to {between[1]:g}" if between else "normal about 1"
    lines = [
        f"flocks whose span ratios are {kind}, {how['coupling']} coupling",
        "  birds   spread   can fly      95 % interval     mean U*   "
        "breaks most if the smallest bird is",
    ]
    for population in populations:
        low, high = population.flying.interval
        speed = f"{population.speed:.4f}" if population.flying.count else ""
        lines.append(
            f"  {population.birds:5}   {population.distribution.spread:<7.4g}  "
            f"{100.0 * population.flying.value:6.2f} %   "
            f"{100.0 * low:6.2f} - {100.0 * high:6.2f} %   "
            f"{speed:<9} {_worst(population)}"
        )
    lines.append(
        f"{how['flocks']:,} flocks in {how['seconds']:.2f} s, "
        f"{how['flocks_per_second']:,.0f} a second, {how['workers']} workers"
    )
    return "\n".join(line.rstrip() for line in lines)


def _worst(population: Population) -> str:
    position = population.worst_position
    if position is None:
        return ""
    broken = population.broken_by_weakest[position - 1]
    place = _place(population.birds, position)
    return f"{place} ({100.0 * broken.value:.1f} %)"


def _place(birds: int, position: int) -> str:
    """Return the name of a position, which is that of one bird on each wing, from the tail."""
    if birds == 2:
        return "either bird"
    if position == 1:
        return "the tail"
    if position == (birds + 1) // 2:
        return "the leader" if birds % 2 else "one of the middle two"
    return f"number {position}"


def _flocks(options: argparse.Namespace) -> list[FlockConfiguration]:
    """Return a standard flock for each requested size."""
    sizes, options.birds = options.birds, None
    flock = flock_configuration(options)
    if flock.span_ratios:
        raise FlockError(
            f"span_ratios in configuration file {options.config}: survey sets all at random; "
            "leave the key out"
        )
    if sizes is None:
        sizes = SIZES if options.config is None else str(flock.birds)
    check_links_exact(flock, "survey")
    check_unforced(flock, "survey")
    # A steady state has no perturbations.
    flock = replace(flock, perturbations=(), links=())
    return [replace(flock, birds=birds) for birds in whole_numbers("--birds", sizes, 2)]


def _distributions(options: argparse.Namespace) -> list[Distribution]:
    from flock_tools.experiments.random_flocks import LARGEST, SMALLEST, Distribution

    if options.uniform is not None:
        low, high = two_numbers(options.uniform)
        if not SMALLEST <= low < high <= LARGEST:
            raise FlockError(
                f"--uniform {shown(options.uniform)}: must be two span ratios LO,HI with "
                f"{SMALLEST:g} <= LO < HI <= {LARGEST:g}, such as 0.9,1.1"
            )
        return [Distribution.uniform(low, high)]
    spreads = numbers(options.spread)
    if not all(0.0 < spread <= 1.0 for spread in spreads):
        raise FlockError(f"--spread {shown(options.spread)}: must be numbers above 0, 1 at most")
    return [Distribution(spread) for spread in spreads]


def main() -> int:
    """Run the `survey` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
