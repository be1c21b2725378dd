# SPDX-License-Identifier: Apache-2.0
"""The FLOCK options of command-line tools, which set the keys of the configuration."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flock_sim.configuration.choices import COUPLINGS
from flock_sim.configuration.perturbation import FORM
from flock_sim.errors import FlockError
from flock_sim.links import keys
from flock_sim.links.registry import MODELS

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration

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
"""The keys of the configuration that have an option, and the option."""


def add_flock_options(parser: argparse.ArgumentParser) -> None:
    """Add FLOCK, the options for the configuration of the flight. None of them has a default."""
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
        metavar=keys.FORM,
        action="append",
        dest="links",
        help="what birds know of their neighbours, or TARGET of SOURCE (quote the >): the model "
        f"{', '.join(model.name for model in MODELS)}, and {', '.join(keys.KEYS)}; may be "
        "repeated, and the last one for a link holds",
    )


def flock_configuration(options: argparse.Namespace) -> FlockConfiguration:
    """Return the configuration that the options give. Raises FlockError on a refused value."""
    # Imported here, since --help needs no numpy, and flocks without a file need no YAML.
    from flock_sim.configuration.flock_configuration import FlockConfiguration

    if not options.config:
        return FlockConfiguration.from_parameters(flock_parameters(options))

    from flock_sim.configuration import parameter_file
    from flock_sim.configuration.operation import parted

    given = parameter_file.read(options.config)
    with named(options.config):
        flown, _ = parted(given)  # a tool without nodes ignores their operation
        return FlockConfiguration.from_parameters({**flown, **flock_parameters(options)})


def flock_parameters(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keys of the configuration that `options` give, with their values."""
    values = {key: getattr(options, key, None) for key in FLOCK_OPTIONS}
    return {key: value for key, value in values.items() if value is not None}


@contextmanager
def named(config: Path) -> Iterator[None]:
    """Add the name of the configuration file `config` to a FlockError of the block."""
    try:
        yield
    except FlockError as error:
        raise FlockError(f"{error} (with configuration file {config})") from None
