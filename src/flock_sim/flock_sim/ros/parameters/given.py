# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes of a process: from the command line and from parameter files."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rclpy.context import Context
from rclpy.node import Node

from flock_sim.configuration import parameter_file
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.operation import DEFAULTS, parted
from flock_sim.configuration.parameter_file import Sections
from flock_sim.console.signals import SUPERVISED
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.ros.fastdds_shutdown import leave
from flock_sim.ros.parameters.node_parameters import check_same, resolved, together


def _reader_name(name: str) -> str:
    return f"_{name}_parameters"  # ROS hides names that begin with an underscore


def is_renamed(reader: Node, name: str) -> bool:
    """Whether a remapping rule gave `reader`, of the node `name`, the name of that node."""
    return bool(reader.get_name() != _reader_name(name))


@contextmanager
def parameter_reader(name: str, context: Context) -> Iterator[Node]:
    """Yield a node that has the parameters given to this process.

    The real node is made after it: its name depends on these parameters.
    """
    reader = Node(
        _reader_name(name),
        namespace="/flock",
        context=context,
        start_parameter_services=False,
        enable_rosout=False,
        automatically_declare_parameters_from_overrides=True,
    )
    try:
        yield reader
    finally:
        leave(context, [reader])  # no effect on a node that is already destroyed


def what_is_given(
    name: str, reader: Node, arguments: Sequence[str]
) -> tuple[FlockConfiguration, dict[str, Any]]:
    """Return the configuration and the operation, from the ROS parameters of `reader`.

    These parameters are for all nodes. Sections of files for the nodes of this process override
    them. Single parameters on the command line override the sections.
    """
    base = {key: p.value for key, p in reader.get_parameters_by_prefix("").items()}
    files, given = _ros_parameters(arguments)
    # A supervisor has read the file for its nodes, and gives each process the result.
    sections = Sections({}) if SUPERVISED in os.environ else parameter_file.sections(*files)
    common = flown, operation = parted(base)
    if not sections.named:
        return FlockConfiguration.given(flown), {**DEFAULTS, **operation}
    birds = _birds(name, operation, sections)
    nodes = [topics.bird_name(bird) for bird in birds] or [name]
    if is_renamed(reader, name):
        nodes = [reader.get_name()]  # a remapping rule of ROS renames the node too
    full = [f"{reader.get_namespace().rstrip('/')}/{node}" for node in nodes]
    found = [resolved(sections, node, common, given) for node in full]
    configuration = FlockConfiguration.given(found[0][0])
    for node, (flown, _) in zip(full, found, strict=True):
        check_same(configuration, flown, node, sections)
    told = {node: operation for node, (_, operation) in zip(full, found, strict=True)}
    for node, bird in zip(full, birds, strict=False):
        _check_index(node, told[node].pop("index", 0), bird)
        told[node].pop("indices", None)
    numbers = {"indices": birds, "index": birds[0]} if birds else {}
    return configuration, {**DEFAULTS, **together(told), **numbers}


def _birds(name: str, operation: Mapping[str, Any], sections: Sections) -> list[int]:
    """Return the birds of this process; none if it is another node, or if they are not given.

    A file with the parameters of one bird only, as `ros2 param dump` writes it, gives the bird.
    """
    if name != "bird":
        return []
    if told := operation.get("indices") or [bird for bird in (operation.get("index"),) if bird]:
        return list(told)
    found = {
        sections.own(node).get("index") for node in sections.named if "index" in sections.own(node)
    }
    return [bird for bird in found if isinstance(bird, int)] if len(found) == 1 else []


def _check_index(node: str, told: int, bird: int) -> None:
    """Raise FlockError if the section of a bird has the index of another one."""
    if told not in (0, bird):
        raise FlockError(f"index = {told} (in a section for {node}): must be {bird}")


def _ros_parameters(arguments: Sequence[str]) -> tuple[list[Path], set[str]]:
    """Return the parameter files and the single parameters among the ROS arguments."""
    files, given, ours = [], set(), True
    for word, following in itertools.pairwise([*arguments, ""]):
        if word in ("--ros-args", "--"):
            ours = word == "--"
        elif not ours and word == "--params-file":
            files.append(Path(following))
        elif not ours and word in ("-p", "--param"):
            given.add(following.partition(":=")[0].rpartition(":")[2])
    return files, given
