# SPDX-License-Identifier: Apache-2.0
"""What all command-line tools share: the FLOCK options, errors in one line, exit statuses."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from flock_sim import configuration_file
from flock_sim.core.configuration import COUPLINGS, FlockConfiguration
from flock_sim.core.links import settings
from flock_sim.core.links.registry import MODELS
from flock_sim.core.perturbation import FORM
from flock_sim.errors import FlockError

INTERRUPTED = 130
BROKEN_PIPE = 141

FLOCK_OPTIONS = {
    "birds": "--birds",
    "span_ratios": "--span-ratio",
    "coupling": "--coupling",
    "dt": "--dt",
    "t_max": "--t-max",
    "record_every": "--record-every",
    "perturbations": "--perturb",
    "links": "--link",
}
"""Keys of the configuration that have an option of their own, and which."""

LONGEST = 1e9
"""The longest time, in s, that anybody may be told to wait."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one line, as all of Flock's are."""

    def __init__(self, tool: str, description: str, examples: str) -> None:
        """Describe `tool`; `examples` closes its help."""
        super().__init__(
            prog=f"./flock {tool}",
            description=description,
            epilog=f"examples:\n{examples}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def error(self, message: str) -> NoReturn:
        """Raise FlockError in place of printing the usage."""
        raise FlockError(f"{message}; {self.prog} --help tells more")


def add_flock_options(parser: argparse.ArgumentParser) -> None:
    """Add FLOCK, the options that say what is flown. None of them has a default of its own."""
    flock = parser.add_argument_group(
        "flock", "what is flown: defaults, then the configuration file, then these options"
    )
    flock.add_argument("--config", metavar="FILE", type=Path, help="ROS 2 parameter file")
    flock.add_argument("--birds", metavar="N", help="number of birds (13)")
    flock.add_argument(
        "--span-ratio",
        metavar="I=LAMBDA[,LAMBDA...]",
        action="append",
        dest="span_ratios",
        help="wing span of bird I over the standard one; several values make as many members, "
        "independent flocks flown at once; may be repeated",
    )
    flock.add_argument(
        "--coupling", metavar="|".join(COUPLINGS), help="whom a bird feels (nearest)"
    )
    flock.add_argument("--dt", metavar="DT", help="step size in b/U_min (1.0)")
    flock.add_argument("--t-max", metavar="T", help="flight time in b/U_min (1e4)")
    flock.add_argument("--record-every", metavar="K", help="steps between recorded states (10)")
    flock.add_argument(
        "--perturb",
        metavar=FORM,
        action="append",
        dest="perturbations",
        help="push a bird at the beginning of a step: change its position, in b, and speed, in "
        "U_min, in one member or all; may be repeated",
    )
    flock.add_argument(
        "--link",
        metavar=settings.FORM,
        action="append",
        dest="links",
        help="what birds know of their neighbours, or TARGET of SOURCE (quote the >): the model "
        f"{', '.join(model.name for model in MODELS)}, and {', '.join(settings.KEYS)}; may be "
        "repeated, and the last one for a link holds",
    )


def flock_configuration(options: argparse.Namespace) -> FlockConfiguration:
    """Return what `add_flock_options` read. Raises FlockError on a value that is refused."""
    parameters = configuration_file.read(options.config) if options.config else {}
    for key in FLOCK_OPTIONS:
        value = getattr(options, key, None)
        if value is not None:
            parameters[key] = value
    try:
        return FlockConfiguration.from_parameters(parameters)
    except FlockError as error:
        if options.config:
            raise FlockError(f"{error} (with configuration file {options.config})") from None
        raise


def whole_number(name: str, text: str, least: int, most: int | None = None) -> int:
    """Return `text` as a whole number within bounds. Raises FlockError otherwise."""
    allowed = f"{least}..{most}" if most is not None else f"{least} or more"
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least or (most is not None and value > most):
        raise FlockError(f"{name} {text}: must be a whole number, {allowed}")
    return value


def whole_numbers(name: str, text: str, least: int, most: int | None = None) -> list[int]:
    """Return the whole numbers in `text`, between commas. Raises FlockError as `whole_number`."""
    try:
        return [whole_number(name, part.strip(), least, most) for part in text.split(",")]
    except FlockError as error:
        if "," not in text:
            raise
        raise FlockError(f"{error} (in {name} {text})") from None


def numbers(text: str) -> list[float]:
    """Return the numbers in `text`, between commas; [nan] for what is none."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return [math.nan]


def positive_number(name: str, text: str) -> float:
    """Return `text` as a number of seconds above 0. Raises FlockError otherwise."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value <= LONGEST:
        raise FlockError(f"{name} {text}: must be a finite number above 0, {LONGEST:g} at most")
    return value


def print_json(value: dict[str, Any]) -> None:
    """Print `value` as one JSON object on stdout."""
    print(json.dumps(value))


def note(line: str) -> None:
    """Tell the user something that is no result: on stderr, so that stdout stays clean."""
    print(line, file=sys.stderr, flush=True)


def run_tool(tool: Callable[[Sequence[str]], int], arguments: Sequence[str] | None = None) -> int:
    """Run `tool` and return its exit status: 0, 1 (answer is no), 2 (bad input), 130 (Ctrl-C)."""
    try:
        return tool(sys.argv[1:] if arguments is None else arguments)
    except FlockError as error:
        note(f"error: {error}")
        return error.exit_status
    except KeyboardInterrupt:
        note("stopped")
        return INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has enough; nothing more can be said on it.
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  (for what is left in its buffer)
        return BROKEN_PIPE
