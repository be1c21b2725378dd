# SPDX-License-Identifier: Apache-2.0
"""The paper's stability diagram: `flock limits`."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flock_sim.configuration.options import (
    FLOCK_OPTIONS,
    add_flock_options,
    flock_configuration,
    note_unused,
)
from flock_sim.console.arguments import (
    TIMEOUT,
    Parser,
    positive_number,
    print_json,
    print_text,
    run_tool,
    whole_number,
    whole_numbers,
)
from flock_sim.errors import FlockError, nearest
from flock_sim.launcher.partition import process_count
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
    from flock_sim.theory.limit_search import Limits
    from flock_tools.experiments.flown_limits import HowFlown

METHODS = ("exact", "integrate", "fly")

QUANTITIES = ("span", "thrust")
"""What of a bird is modified."""

OF_METHODS = {
    "points": ("integrate", "fly"),
    "resolution": ("integrate",),
    "scheduler": ("integrate",),
    "processes": ("fly",),
    "timeout": ("fly",),
    "bag": ("fly",),
}
"""Options that only some methods have, and the methods that have them."""

BETWEEN = {"span": "0.5,1.5", "thrust": "0,2"}
"""Default intervals that are searched: the paper's range of span ratios, and that of T/T_0."""

RESOLUTION = "1e-3"

ENDS = "2"
GRID = "41"
"""Default numbers of span ratios per bird: of integrate, before bisection, and of fly."""

MOST_POINTS = 1001
"""Largest number of span ratios per bird: all are members of one message."""

PROCESSES = "2"

LEAST_RESOLUTION = 1e-12
"""Smallest --resolution: below it, rounding stops the bisection of a span ratio."""

DESCRIPTION = """\
Find out how far the span of one bird can differ before the flock can't fly in formation any more.
The result is an interval of its span ratio lambda, and the gap that opens at each end. Birds are
modified one at a time. With --of thrust, the result is an interval of T/T_0: how much thrust a bird
can lose or add. T_0 = lambda^4 k (U_0^2 + U_0^-2) is the usual thrust of that bird. Its span and
all other birds stay as they are. A bird with T = 0 glides.
Methods (--method):
  exact      from the existence of the steady state
  integrate  by flights as in the paper, without ROS: a flight begins with the V of the homogeneous
             flock, and the flock holds if sigma_U < 1e-4 at --t-max. This is the criterion of the
             paper, not the verdict of metrics. The limit is found by bisection to --resolution.
  fly        by the same flights over ROS 2: --points span ratios of each modified bird, all of them
             members of one flight. A limit lies half way between two of them.
Only exact limits exist for --of thrust. Only integrate and fly use --dt, --t-max and --forcing.
All links are exact. If the flock is its own mirror image, only birds of the left wing are modified.
An end outside the searched interval is printed as "below" or "above" it, and is null in JSON.
Exit status: 0, whether limits exist or not; 1 a flight failed; 2 bad input."""

EXAMPLES = """\
  ./flock limits --birds 13 --output limits.png
  ./flock limits --coupling all --json | jq '.limits[0]'
  ./flock limits --of thrust --output thrust.png
  ./flock limits --of thrust --span-ratio 3=1.05 --bird 2,3 --between 0.8,1.3
  ./flock limits --method integrate --t-max 1e5 --resolution 1e-3
  ./flock limits --method integrate --t-max 1e5 --scheduler tcp://127.0.0.1:8786
  ./flock limits --method fly --t-max 1e5 --processes 2"""


def tool(arguments: Sequence[str]) -> int:
    """Find the limits and print them."""
    options = _parser().parse_args(arguments)
    _check_method(options)
    _check_quantity(options)
    configuration = _flock(options)
    birds = _birds(options, configuration)
    low, high = _between(options)
    check_picture(options.output)
    found, how = _found(options, configuration, birds, low, high)

    from flock_tools.experiments.limits_text import as_json, described

    facts = {
        "birds": configuration.birds,
        "coupling": configuration.coupling,
        "of": options.of,
        "method": options.method,
        "limits": [as_json(limits, options.method != "exact") for limits in found],
        "between": [low, high],
        **how,
    }
    if options.json:
        print_json(facts)
    else:
        print_text(described(found, facts))
    if options.output is not None:
        from flock_tools.figures.limits import draw_limits  # matplotlib takes 0.5 s to import

        drawn = draw_limits(found, configuration, low, high, options.of)
        write_picture(drawn, options.output)
        if not options.json:
            print_text(f"drawn: {options.output}")
    return 0


def _parser() -> Parser:
    parser = Parser("limits", DESCRIPTION, EXAMPLES)
    add_flock_options(parser, ignored=("record_every", "perturbations"), refused=("links",))
    limits = parser.add_argument_group("limits")
    limits.add_argument(
        "--of",
        metavar="|".join(QUANTITIES),
        default="span",
        help="quantity of a bird that is modified: its span ratio, or its thrust (span)",
    )
    limits.add_argument(
        "--method", metavar="|".join(METHODS), default="exact", help="how limits are found (exact)"
    )
    limits.add_argument(
        "--bird",
        metavar="I[,I...]",
        help="birds that are modified, each in turn (the left wing, or all)",
    )
    limits.add_argument(
        "--between",
        metavar="LO,HI",
        help=f"interval that is searched: of lambda ({BETWEEN['span']}), or of T/T_0 "
        f"({BETWEEN['thrust']})",
    )
    limits.add_argument(
        "--resolution",
        metavar="X",
        help=f"for integrate: width at which the bisection ends ({RESOLUTION})",
    )
    add_scheduler_option(limits, "integrates")
    limits.add_argument(
        "--points",
        metavar="N",
        help=f"number of evenly spaced span ratios per bird: for fly all ({GRID}), for integrate "
        f"those before the bisection ({ENDS})",
    )
    limits.add_argument(
        "--processes",
        metavar="P",
        help=f"for fly: number of processes that the birds share ({PROCESSES})",
    )
    limits.add_argument(
        "--timeout",
        metavar="S",
        help=f"for fly: time without progress after which the flight fails, in s ({TIMEOUT})",
    )
    limits.add_argument(
        "--bag", metavar="DIR", type=Path, help="for fly: keep the bag in this new directory"
    )
    add_picture_options(parser, "file for a picture of the diagram")
    return parser


def _found(
    options: argparse.Namespace,
    configuration: FlockConfiguration,
    birds: Sequence[int],
    low: float,
    high: float,
) -> tuple[list[Limits], dict[str, Any]]:
    """Return the limits by the method of the options, and facts of how they were found."""
    searched = configuration, birds, low, high
    if options.method == "integrate":
        from flock_tools.experiments.integrated_limits import integrated_limits

        resolution, points = _resolution(options), _points(options, ENDS)
        return integrated_limits(*searched, points, resolution, options.scheduler)
    if options.method == "fly":
        from flock_tools.experiments.flown_limits import flown_limits

        return flown_limits(*searched, _points(options, GRID), _how_flown(options, configuration))

    from flock_sim.launcher.precompile import warm_equilibrium
    from flock_sim.physics.flock import Flock
    from flock_sim.theory.equilibrium import equilibrium
    from flock_sim.theory.span_limits import exact_limits
    from flock_sim.theory.thrust_limits import exact_thrust_limits

    warm_equilibrium(configuration.coupling)
    begun = time.perf_counter()
    found = (exact_limits if options.of == "span" else exact_thrust_limits)(*searched)
    seconds = time.perf_counter() - begun
    as_given = bool(equilibrium(Flock.of(configuration)).exists[0])
    return found, {"seconds": seconds, "as_given": as_given}


def _check_method(options: argparse.Namespace) -> None:
    """Raise FlockError on an unknown method, or on an option that the method does not have.

    The time of a flight is an option of the flock, and has no effect on the exact method.
    """
    if options.method not in METHODS:
        raise FlockError(f"--method {options.method!r}: {nearest(options.method, METHODS)}")
    for name, methods in OF_METHODS.items():
        if getattr(options, name) is not None and options.method not in methods:
            raise FlockError(
                f"--{name} is for --method {' and '.join(methods)}: leave it out with "
                f"{options.method}"
            )
    for name in ("dt", "t_max"):
        if options.method == "exact" and getattr(options, name) is not None:
            note_unused(options, FLOCK_OPTIONS[name])


def _check_quantity(options: argparse.Namespace) -> None:
    """Raise FlockError on an unknown quantity, or on one whose limits can only be computed."""
    if options.of not in QUANTITIES:
        raise FlockError(f"--of {shown(options.of)}: {nearest(options.of, QUANTITIES)}")
    if options.of != "span" and options.method != "exact":
        raise FlockError(
            f"--method {options.method} is for --of span: limits of {options.of} are exact; leave "
            "--method out"
        )


def _points(options: argparse.Namespace, default: str) -> int:
    text = default if options.points is None else options.points
    return whole_number("--points", text, 2, MOST_POINTS)


def _how_flown(options: argparse.Namespace, configuration: FlockConfiguration) -> HowFlown:
    processes = PROCESSES if options.processes is None else options.processes
    timeout = TIMEOUT if options.timeout is None else options.timeout
    if options.bag is not None and options.bag.exists():
        raise FlockError(f"--bag {options.bag} exists: name a directory that does not exist")

    from flock_tools.experiments.flown_limits import HowFlown

    return HowFlown(
        process_count("--processes", processes, configuration.birds, configuration.coupling),
        positive_number("--timeout", timeout),
        options.bag,
    )


def _flock(options: argparse.Namespace) -> FlockConfiguration:
    configuration = flock_configuration(options)
    check_links_exact(configuration, "limits")
    if options.method == "exact":
        check_unforced(configuration, "limits --method exact")
    if configuration.birds < 2:
        raise FlockError(
            f"birds = {configuration.birds}: must be 2 or more, since limits need a formation"
        )
    if configuration.members > 1:
        raise FlockError(
            f"the flock has {configuration.members} members: must have one; give one span ratio "
            "for each bird, and one value of each key of forcing"
        )
    return configuration


def _birds(options: argparse.Namespace, configuration: FlockConfiguration) -> list[int]:
    if options.bird is None:
        from flock_sim.theory.span_limits import modified_birds

        return modified_birds(configuration)
    return list(dict.fromkeys(whole_numbers("--bird", options.bird, 1, configuration.birds)))


def _between(options: argparse.Namespace) -> tuple[float, float]:
    usual = BETWEEN[options.of]
    text = usual if options.between is None else options.between
    low, high = two_numbers(text)
    if options.of == "thrust":
        allowed, ratios, least = low >= 0.0, "ratios T/T_0", "0 <= LO"
    else:
        allowed, ratios, least = low > 0.0, "span ratios", "0 < LO"
    if not (allowed and low < high < math.inf):
        raise FlockError(
            f"--between {shown(text)}: must be two {ratios} LO,HI with {least} < HI, such as "
            f"{usual}"
        )
    return low, high


def _resolution(options: argparse.Namespace) -> float:
    text = RESOLUTION if options.resolution is None else options.resolution
    try:
        resolution = float(text)
    except ValueError:
        resolution = math.nan
    if not LEAST_RESOLUTION <= resolution < 1.0:
        raise FlockError(
            f"--resolution {shown(text)}: must be a number from {LEAST_RESOLUTION:g} to below 1"
        )
    return resolution


def main() -> int:
    """Run the `limits` executable."""
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
