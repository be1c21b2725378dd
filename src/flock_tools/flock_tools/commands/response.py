# SPDX-License-Identifier: Apache-2.0
"""The linear response of a flock at its steady state: `flock response`."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from flock_sim.configuration.options import FLIGHT, add_flock_options, flock_configuration
from flock_sim.console.arguments import (
    Parser,
    not_negative_number,
    print_json,
    print_text,
    run_tool,
    whole_number,
)
from flock_sim.errors import FlockError, nearest
from flock_tools.commands.options import add_picture_options, check_links_exact, check_unforced
from flock_tools.figures.output import check_picture, write_picture

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.physics.flock import Flock
    from flock_sim.theory.sensitivity import Sensitivity

MODELS = ("linear", "hold")
"""How a bird uses a state that is one lag old; the first is the default."""

MOST_TO_ALL = 201
"""Largest number of birds with all-to-all coupling, whose dense matrices take some minutes."""

DESCRIPTION = """\
Compute how a flock in steady flight responds to small disturbances: whether changes of the leader's
speed are amplified from bird to bird (string stability), the largest amplitude of the gaps over
that of the accelerations that cause it (the H-infinity norm), and with --gust the standard
deviations in white gusts. With --lag, each bird uses the states of its neighbours a constant time
late.
Lengths are in b (half the standard wing span), speeds in U_min, times in b/U_min, frequencies omega
in U_min/b; the gap i is between birds i and i + 1.
The flock is not flown: links are exact, and there is no forcing.
Exit status: 0, whether the flock has a stable steady state or not; 1 it can't be computed; 2 bad
input."""

EXAMPLES = """\
  ./flock response --birds 13 --gust 2e-5 --output response.png
  ./flock response --coupling all --lag 20 --link-model hold
  ./flock response --span-ratio 4=0.99,1.0,1.01 --json | jq '.hinf_gaps'
  ./flock response --birds 7 --sensitivity"""


def tool(arguments: Sequence[str]) -> int:
    """Compute the response and print it."""
    options = _parser().parse_args(arguments)
    configuration = _flock(options)
    lag = 0.0 if options.lag is None else not_negative_number("--lag", options.lag)
    gust = None if options.gust is None else not_negative_number("--gust", options.gust)
    model = _model(options)
    member = whole_number("--member", options.member, 1, configuration.members)
    if options.sensitivity and lag:
        raise FlockError("--sensitivity is for flocks without a lag: leave out --lag")
    if options.output is not None and configuration.birds == 1:
        raise FlockError("--output: a picture needs a flock of 2 birds or more, not a bird alone")
    check_picture(options.output)

    from flock_sim.console.progress import counter
    from flock_sim.launcher.precompile import warm_response
    from flock_sim.physics.flock import Flock
    from flock_sim.response.linear_response import linear_response
    from flock_tools.experiments.response_text import as_json, described

    warm_response(configuration.coupling)
    flock = Flock.of(configuration)
    begun = time.perf_counter()
    with counter("computing", "flocks", configuration.members) as show:
        found = linear_response(flock, lag=lag, model=model, gust=gust, on_member=show)
    seconds = time.perf_counter() - begun
    derivatives = _sensitivity(flock) if options.sensitivity else None
    if options.json:
        how = {"lag": lag, "link_model": model if lag else None, "seconds": seconds}
        print_json({**as_json(configuration, found, derivatives), **how})
    else:
        links = f"links `{model}` with a lag of {lag:g}" if lag else "exact links"
        print_text(described(configuration, found, derivatives, links))
    if options.output is not None:
        from flock_tools.figures.response import draw_response  # matplotlib takes 0.5 s to import

        figure = draw_response(configuration, found, member, lag, model)
        write_picture(figure, options.output)
        if not options.json:
            print_text(f"drawn: {options.output}")
    return 0


def _parser() -> Parser:
    parser = Parser("response", DESCRIPTION, EXAMPLES)
    add_flock_options(parser, FLIGHT, refused=("links", "forcing"))
    group = parser.add_argument_group("response")
    group.add_argument(
        "--lag",
        metavar="TAU",
        help="constant time by which the states of neighbours are late, in b/U_min (0)",
    )
    group.add_argument(
        "--link-model",
        metavar="|".join(MODELS),
        default=MODELS[0],
        help="late states are extrapolated at their speed, or held (linear)",
    )
    group.add_argument(
        "--gust",
        metavar="STD",
        help="also compute standard deviations in independent white accelerations of all birds, "
        "dU = STD dW, STD in U_min per sqrt(b/U_min)",
    )
    group.add_argument(
        "--sensitivity",
        action="store_true",
        help="also compute derivatives of speed, spacings, shares and margin by the span ratios",
    )
    group.add_argument(
        "--member", metavar="M", default="1", help="number of the member of the picture (1)"
    )
    add_picture_options(parser, "file for a picture of gains and of gusts")
    return parser


def _flock(options: argparse.Namespace) -> FlockConfiguration:
    configuration = flock_configuration(options)
    check_links_exact(configuration, "response")
    check_unforced(configuration, "response")
    if configuration.coupling == "all" and configuration.birds > MOST_TO_ALL:
        raise FlockError(
            f"birds = {configuration.birds}: must be {MOST_TO_ALL} or less with --coupling all, "
            "which would take hours; with --coupling nearest any number will do"
        )
    return configuration


def _model(options: argparse.Namespace) -> str:
    model: str = options.link_model
    if model not in MODELS:
        raise FlockError(f"--link-model {model!r}: {nearest(model, MODELS)}")
    return model


def _sensitivity(flock: Flock) -> Sensitivity:
    from flock_sim.theory.equilibrium import equilibrium
    from flock_sim.theory.sensitivity import sensitivity

    return sensitivity(flock, equilibrium(flock))


def main() -> int:
    """Run the `response` executable."""
    # The matrices are too small for the threads of OpenBLAS, which would wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    return run_tool(tool)


if __name__ == "__main__":
    sys.exit(main())
