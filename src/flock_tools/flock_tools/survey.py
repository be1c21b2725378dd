# SPDX-License-Identifier: Apache-2.0
"""Flocks in which every bird differs: `flock survey`."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from flock_sim.command_line import (
    Parser,
    add_flock_options,
    flock_configuration,
    print_json,
    run_tool,
    whole_number,
)
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.metrics import plain
from flock_sim.errors import FlockError
from flock_sim.progress import counter
from flock_sim.warm import warm_steady_states
from flock_tools.population import SMALLEST, Distribution, Population, survey
from flock_tools.workers import workers

SIZES = "3,7,13,31"
SPREADS = "0.0025,0.005,0.0075,0.01,0.015,0.02,0.03,0.04,0.06"
SAMPLES = "10000"

DESCRIPTION = """\
Draw flocks in which every bird differs, and count how many can fly in formation: the fraction
against the spread of span ratios, with 95 % confidence intervals, and how often a flock breaks
whose smallest bird is at the tail, ..., the leader. The same seed draws the same flocks, whoever
computes."""

EXAMPLES = """\
  ./flock survey --output survey.png
  ./flock survey --birds 13 --spread 0.01,0.02 --samples 100000 --seed 7
  ./flock survey --birds 5,7 --uniform 0.9,1.1 --coupling all --json"""


def tool(arguments: Sequence[str]) -> int:
    """Draw flocks, solve for their steady states, and say how many have one."""
    parser = Parser("survey", DESCRIPTION, EXAMPLES)
    add_flock_options(parser)
    drawn = parser.add_argument_group("survey", "--birds may be several here: N[,N...]")
    which = drawn.add_mutually_exclusive_group()
    which.add_argument(
        "--spread",
        metavar="S[,S...]",
        help=f"standard deviations of span ratios, normal about 1 ({SPREADS})",
    )
    which.add_argument("--uniform", metavar="LO,HI", help="draw them uniformly from an interval")
    drawn.add_argument(
        "--samples", metavar="K", default=SAMPLES, help=f"flocks of each kind ({SAMPLES})"
    )
    drawn.add_argument("--seed", metavar="SEED", default="0", help="of the random numbers (0)")
    drawn.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler whose cluster computes (the cores of this machine)",
    )
    result = parser.add_argument_group("result")
    result.add_argument("--output", metavar="FILE", type=Path, help="draw it: png, svg, pdf")
    result.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    options = parser.parse_args(arguments)
    flocks = _flocks(options)
    distributions = _distributions(options)
    samples = whole_number("--samples", options.samples, 1)
    seed = whole_number("--seed", options.seed, 0)
    draw = _drawing(options)

    warm_steady_states()
    populations = []
    begun = time.perf_counter()
    solved = 0
    total = len(flocks) * len(distributions) * samples
    with workers(options.scheduler) as crew, counter("solving", "flocks", total) as show:
        for flock in flocks:
            for number, distribution in enumerate(distributions):

                def told(count: int) -> None:
                    nonlocal solved
                    solved += count
                    show(solved)

                populations.append(
                    survey(flock, distribution, samples, (seed, flock.birds, number), crew, told)
                )
        seconds = time.perf_counter() - begun
        how = {
            "coupling": flocks[0].coupling,
            "seed": seed,
            "flocks": solved,
            "seconds": seconds,
            "flocks_per_second": solved / seconds,
            "workers": crew.count,
        }
    draw(populations)
    if options.json:
        facts = [
            {name: plain(value) for name, value in population.as_json().items()}
            for population in populations
        ]
        print_json({**how, "results": facts})
    else:
        print(told_of(populations, how))
        if options.output is not None:
            print(f"drawn: {options.output}")
    return 0


def told_of(populations: Sequence[Population], how: dict[str, Any]) -> str:
    """Return the result as people read it."""
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
    last = len(population.broken_by_weakest)
    names = {1: "the tail", last: "the leader"}
    place = names.get(position, f"number {position}")
    return f"{place} ({100.0 * broken.value:.1f} %)"


def _drawing(options: argparse.Namespace) -> Callable[[Sequence[Population]], None]:
    """Return what draws the survey; refuse a name that no picture can have before we compute."""
    if options.output is None:
        return lambda populations: None
    # Not above: half a second, for which only pictures wait.
    from flock_tools.figure_survey import draw_survey
    from flock_tools.picture_file import picture_format, write_picture

    picture_format(options.output)
    return lambda populations: write_picture(draw_survey(populations), options.output)


def _flocks(options: argparse.Namespace) -> list[FlockConfiguration]:
    """Return the standard flocks of all sizes that were asked for."""
    given = options.birds
    options.birds = None
    flock = flock_configuration(options)
    if flock.span_ratios:
        raise FlockError("--span-ratio: all span ratios are drawn here; leave it out")
    if given is None:
        given = SIZES if options.config is None else str(flock.birds)
    sizes = [whole_number("--birds", text.strip(), 2) for text in given.split(",")]
    return [replace(flock, birds=birds) for birds in sizes]


def _distributions(options: argparse.Namespace) -> list[Distribution]:
    if options.uniform is not None:
        low, high = _numbers(options.uniform, 2)
        if not SMALLEST <= low < high < math.inf:
            raise FlockError(
                f"--uniform {options.uniform}: must be two span ratios LO,HI with "
                f"{SMALLEST:g} <= LO < HI, such as 0.9,1.1"
            )
        return [Distribution.uniform(low, high)]
    spreads = _numbers(options.spread or SPREADS)
    for spread in spreads:
        if not 0.0 < spread <= 1.0:
            raise FlockError(f"--spread {options.spread}: must be numbers above 0, 1 at most")
    return [Distribution(spread) for spread in spreads]


def _numbers(text: str, count: int | None = None) -> list[float]:
    """Return the numbers in `text`; nan for what is none, or where there are not `count`."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = [math.nan]
    return numbers if count in (None, len(numbers)) else [math.nan] * (count or 1)


def main() -> int:
    """Run the `survey` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
