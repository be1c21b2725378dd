# SPDX-License-Identifier: Apache-2.0
"""The FLOCK options of command-line tools, which set the keys of the configuration."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flock_sim.configuration.flock_configuration import KEYS, FlockConfiguration
from flock_sim.errors import FlockError

FLOCK_OPTIONS = {
    "birds": "--birds",
    "span_ratios": "--span-ratio",
    "coupling": "--coupling",
    "dt": "--dt",
    "t_max": "--t-max",
    "record_every": "--record-every",
    "perturbations": "--perturb",
    "links": "--link",
    "forcing": "--forcing",
}
"""The keys of the configuration that have an option, and the option."""

METAVARS = {"birds": "N", "dt": "DT", "t_max": "T", "record_every": "K"}
"""The names of numbers in help."""


def add_flock_options(parser: argparse.ArgumentParser) -> None:
    """Add FLOCK, the options for the configuration of the flight. None of them has a default."""
    flock = parser.add_argument_group(
        "flock", "these options override the configuration file, which overrides the defaults"
    )
    add_config_option(flock)
    for name in FLOCK_OPTIONS:
        add_flock_option(flock, name)


def add_config_option(group: argparse._ArgumentGroup) -> None:
    """Add --config, the configuration file."""
    group.add_argument("--config", metavar="FILE", type=Path, help="ROS 2 parameter file")


def add_flock_option(group: argparse._ArgumentGroup, name: str) -> None:
    """Add the option for the key `name` of the configuration."""
    key, option = KEYS[name], FLOCK_OPTIONS[name]
    if key.form:
        told = f"{key.text}; may be repeated"
        group.add_argument(option, dest=name, metavar=key.form, action="append", help=told)
    else:
        metavar = "|".join(key.choices) or METAVARS[name]
        told = f"{key.text} ({key.default})"
        group.add_argument(option, dest=name, metavar=metavar, help=told)


def flock_configuration(options: argparse.Namespace) -> FlockConfiguration:
    """Return the configuration that the options give. Raises FlockError on a refused value."""
    if not options.config:
        return FlockConfiguration.given(flock_parameters(options))

    # Imported here, since flocks without a file need no YAML.
    from flock_sim.configuration import parameter_file
    from flock_sim.configuration.operation import parted

    given = parameter_file.read(options.config)
    with named(options.config):
        flown, _ = parted(given)  # a tool without nodes ignores their operation
        return FlockConfiguration.given({**flown, **flock_parameters(options)})


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
