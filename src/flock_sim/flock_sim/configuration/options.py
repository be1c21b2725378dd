# SPDX-License-Identifier: Apache-2.0
"""The FLOCK options of command-line tools, which set the keys of the configuration."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flock_sim.configuration.flock_configuration import KEYS, FlockConfiguration
from flock_sim.console.arguments import note
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

FLIGHT = ("dt", "t_max", "record_every", "perturbations")
"""Keys that do not matter without a flight."""

METAVARS = {"birds": "N", "dt": "DT", "t_max": "T", "record_every": "K"}
"""The names of numbers in help."""

LINKS_TOLD = """\
MODEL is what a bird knows of a neighbour. Without --link it is exact.

  exact     the state of the neighbour at every Runge-Kutta stage, as in the paper:
            four messages a step
  hold      the last message that has arrived, unchanged: a receiver that does not
            extrapolate
  linear    the last message that has arrived, extrapolated at the speed in it: the
            closest to exact if messages are rare or late

  KEY       unit      default
  interval  steps     1        time between two messages, for hold and linear
  delay     steps     0        time by which a message is late
  jitter    steps     0        largest additional delay; drawn for each message
  drop      -         0        probability that a message is lost: 0, or more, below 1
  noise     b, U_min  0        standard deviation of noise on position and speed; for
                               one of them: position_noise, speed_noise
  quantum   b, U_min  0        step to which position and speed are rounded; for one
                               of them: position_quantum, speed_quantum
  range     b         inf      largest distance at which a message is received
  timeout   steps     inf      age of the last message beyond which the neighbour has
                               no effect
  seed      -         0        seed of the random numbers

3:4=hold is for what bird 4 knows of bird 3. '3->4=hold' is the same; it needs the
quotes, since > is an operator of the shell."""
"""Help on links: the models of `links/models.py`, and the keys of `links/keys.py`."""


def add_flock_options(
    parser: argparse.ArgumentParser,
    ignored: Collection[str] = (),
    refused: Collection[str] = (),
) -> None:
    """Add FLOCK, the options for the configuration of the flight. None of them has a default.

    The help does not show the options of the keys `ignored`, which have no effect on the tool, and
    `refused`, which must have their defaults. `flock_configuration` notes ignored options.
    """
    flock = parser.add_argument_group(
        "flock", "these options override the configuration file, which overrides the defaults"
    )
    add_config_option(flock)
    for name in FLOCK_OPTIONS:
        if name in (*ignored, *refused):
            _add_hidden_option(flock, name, noted=name in ignored)
        elif name == "links":
            add_flock_option(parser.add_argument_group("links", LINKS_TOLD), name)
        else:
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


class _Unused(argparse.Action):
    """Stores the value of an option, or appends it to a list, and its name among the unused."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        before, many = getattr(namespace, self.dest), bool(KEYS[self.dest].form)
        note_unused(namespace, FLOCK_OPTIONS[self.dest])
        setattr(namespace, self.dest, [*(before or ()), values] if many else values)


def _add_hidden_option(group: argparse._ArgumentGroup, name: str, noted: bool) -> None:
    """Add the option for the key `name` without help; `noted`: note that it is not used."""
    stored = "append" if KEYS[name].form else "store"
    group.add_argument(
        FLOCK_OPTIONS[name],
        dest=name,
        action=_Unused if noted else stored,
        help=argparse.SUPPRESS,
    )


def note_unused(options: argparse.Namespace, option: str) -> None:
    """Let `flock_configuration` note that the tool does not use `option`, which was given."""
    options.unused = [*dict.fromkeys([*getattr(options, "unused", ()), option])]


def flock_configuration(options: argparse.Namespace) -> FlockConfiguration:
    """Return the configuration that the options give. Raises FlockError on a refused value."""
    configuration = _configuration(options)
    if unused := getattr(options, "unused", ()):
        note(f"note: {', '.join(unused)}: no effect on the result of this tool")
    return configuration


def _configuration(options: argparse.Namespace) -> FlockConfiguration:
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
