# SPDX-License-Identifier: Apache-2.0
"""What the launch files can be told, and what they make of it; needs no `launch`."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from flock_sim import configuration_file
from flock_sim.command_line import whole_number
from flock_sim.core.configuration import MEANING, FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.nodes.parameters import OPERATION_MEANING
from flock_sim.shares import shares

ARGUMENTS = {
    "birds": ("", "number of birds; empty: what `config` says, else 13"),
    "config": ("", "ROS 2 parameter file that says what is flown; empty: none"),
    "output": ("", "directory of the bag; empty: a new runs/launch-DATE-TIME"),
    "record": ("true", "whether the flight is recorded"),
    "respawn": ("true", "whether a node that dies is started again"),
}
"""The default and the description of every argument of the launch files."""

PROCESSES = {"processes": ("1", "number of processes that share the birds")}
"""Those that composed.launch.py has beside them."""

SWITCH = {"true": True, "false": False}


@dataclass(frozen=True)
class Arguments:
    """What a launch was told, checked. `config` is empty where there is none."""

    configuration: FlockConfiguration
    config: str
    output: str
    record: bool
    respawn: bool
    processes: int

    @classmethod
    def read(cls, given: Mapping[str, str]) -> Arguments:
        """Return what `given`, each argument as text, comes to. Raises FlockError if it is wrong.

        Without `processes`, every bird has one of its own.
        """
        configuration = _configuration(given["birds"], given["config"])
        birds = configuration.birds
        return cls(
            configuration,
            given["config"],
            given["output"] or f"runs/launch-{datetime.now():%Y%m%d-%H%M%S}",
            _switch("record", given["record"]),
            _switch("respawn", given["respawn"]),
            whole_number("processes", given.get("processes", str(birds)), 1, birds),
        )

    def shares(self) -> list[list[int]]:
        """Return the birds of each process."""
        return shares(self.configuration.birds, self.processes)


def refuse_others(words: Sequence[str], known: Sequence[str]) -> None:
    """Raise FlockError if `words`, as in NAME:=VALUE, name what is meant for Flock and not `known`.

    `launch` takes any name in silence. Those that resemble none of ours may be another launch
    file's, which includes this one.
    """
    parameters = {**MEANING, **OPERATION_MEANING}
    for name in (word.partition(":=")[0] for word in words):
        if name in known:
            continue
        if name in PROCESSES:
            raise FlockError(
                f"{name} is an argument of composed.launch.py: here every bird has its own process"
            )
        if name in parameters:
            raise FlockError(
                f"{name} is no argument of this launch file: write it in a parameter file, and "
                "name that as in config:=flock.yaml"
            )
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.75)
        if close:
            raise FlockError(f"unknown launch argument {name!r}: did you mean {close[0]!r}?")


def _configuration(birds: str, config: str) -> FlockConfiguration:
    """Return what is flown; how nodes operate is theirs to read in the same file."""
    parameters = configuration_file.read(Path(config)) if config else {}
    flown = {key: value for key, value in parameters.items() if key not in OPERATION_MEANING}
    if birds:
        flown["birds"] = birds
    try:
        return FlockConfiguration.from_parameters(flown)
    except FlockError as error:
        raise FlockError(f"{error} (with config:={config})" if config else str(error)) from None


def _switch(name: str, text: str) -> bool:
    try:
        return SWITCH[text.lower()]
    except KeyError:
        raise FlockError(f"{name} = {text}: must be true or false") from None
