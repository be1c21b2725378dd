# SPDX-License-Identifier: Apache-2.0
"""The arguments of the launch files, and their checks; needs no `launch`."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from flock_sim.configuration.flock_configuration import KEYS, FlockConfiguration
from flock_sim.configuration.operation import OPERATION
from flock_sim.errors import FlockError
from flock_sim.launcher.partition import MOST_PROCESSES, partition, process_count
from flock_sim.messages.topics import NAMESPACE, RECORDER
from flock_sim.outside.printing import shown
from flock_sim.ros.parameters.node_parameters import FlightParameters, of_flight

ARGUMENTS = {
    "birds": ("", "number of birds; empty: the number in `config`, or 13"),
    "config": ("", "ROS 2 parameter file with the configuration; empty: none"),
    "output": ("", "directory of the bag; empty: a new runs/launch-DATE-TIME"),
    "namespace": (
        "",
        "namespace of the nodes, also below a pushed one; empty: flock, or the pushed one",
    ),
    "record": ("true", "whether the flight is recorded"),
    "respawn": ("true", "whether a node that was killed is started again"),
}
"""The default and the description of every argument of the launch files."""

PROCESSES = {"processes": ("1", "number of processes that share the birds")}
"""Further arguments of composed.launch.py."""

_NAMESPACE = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)

SWITCH = {"true": True, "false": False}


@dataclass(frozen=True)
class Arguments:
    """The checked arguments of a launch. `config` or `namespace` is empty if none is given."""

    configuration: FlockConfiguration
    config: str
    output: str
    namespace: str
    record: bool
    respawn: bool
    processes: int

    @classmethod
    def read(cls, given: Mapping[str, str], pushed: str = "") -> Arguments:
        """Return the arguments from `given`, their texts. Raises FlockError if one is wrong.

        `pushed` is the namespace of the launch file that includes this one, by PushRosNamespace.
        Without `processes`, every bird has its own process.
        """
        within = given["namespace"]
        if within:
            _check_namespace(within)
        full = within if within.startswith("/") else f"{pushed.rstrip('/')}/{within}".rstrip("/")
        told = _told(given["birds"], given["config"], full or NAMESPACE)
        birds = told.configuration.birds
        output = given["output"] or told.of([RECORDER]).get("output")

        if "processes" not in given and birds > MOST_PROCESSES:
            raise FlockError(
                f"birds {birds}: here every bird has its own process, and at most {MOST_PROCESSES} "
                "can fly on one machine; use composed.launch.py with "
                f"processes:={MOST_PROCESSES} or less"
            )
        return cls(
            told.configuration,
            given["config"],
            # With the process id: launches that start together are separate flights.
            output or f"runs/launch-{datetime.now():%Y%m%d-%H%M%S}-{os.getpid()}",
            within,
            _switch("record", given["record"]),
            _switch("respawn", given["respawn"]),
            process_count(
                "processes", given.get("processes", str(birds)), birds, told.configuration.coupling
            ),
        )

    def partition(self) -> list[list[int]]:
        """Return the birds of each process."""
        return partition(self.configuration.birds, self.processes)


def refuse_others(words: Sequence[str], known: Sequence[str]) -> None:
    """Raise FlockError if `words`, as in NAME:=VALUE, are meant for Flock but not `known`.

    `launch` accepts any name without a warning. A name that resembles none of ours may belong to
    another launch file that includes this one.
    """
    parameters = {*KEYS, *OPERATION} - {"indices"}
    for name in (word.partition(":=")[0] for word in words):
        if name in known:
            continue
        if name in PROCESSES:
            raise FlockError(
                f"{name} is an argument of composed.launch.py: here every bird has its own process"
            )
        if name in parameters:
            raise FlockError(
                f"{name} is not an argument of this launch file: write it in a parameter file, and "
                "name that file, as in config:=flock.yaml"
            )
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.75)
        if close:
            raise FlockError(f"unknown launch argument {name!r}: did you mean {close[0]!r}?")


def _told(birds: str, config: str, namespace: str) -> FlightParameters:
    """Return the configuration, and the file's operation of nodes, which read it themselves."""
    options = {"birds": birds} if birds else {}
    if not config:
        return FlightParameters(FlockConfiguration.given(options))
    try:
        return of_flight(Path(config), options, namespace)
    except FlockError as error:
        raise FlockError(f"{error} (with config:={config})") from None


def _check_namespace(text: str) -> None:
    if not _NAMESPACE.fullmatch(text):
        raise FlockError(
            f"namespace = {shown(text)}: must be names of letters, digits and _ between slashes, "
            "as in left or /fleet/left"
        )


def _switch(name: str, text: str) -> bool:
    try:
        return SWITCH[text.lower()]
    except KeyError:
        raise FlockError(f"{name} = {text}: must be true or false") from None
