# SPDX-License-Identifier: Apache-2.0
"""ROS arguments of a tool that is not a single node: `./flock fly ... --ros-args -r __ns:=/left`.

They go to all nodes of the tool.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from flock_sim.errors import FlockError

BEGIN, END = "--ros-args", "--"

_PARAMETERS = ("-p", "--param", "--params-file")
_RENAMES = ("__node:=", "__name:=")


def split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the arguments of a tool, and those for ROS with their `--ros-args`.

    Raises FlockError if ROS can't read them, or if they are parameters or names of nodes.
    """
    own: list[str] = []
    ros: list[str] = []
    within = False
    for word in arguments:
        within = (within or word == BEGIN) and word != END
        if within or (word == END and ros):
            ros.append(word)
        else:
            own.append(word)
    if ros:
        _check(ros)
    return own, ros


def namespace(ros: Sequence[str]) -> str:
    """Return the namespace that ROS arguments give to all nodes, or the default one."""
    # Imported here, since --help needs no numpy.
    from flock_sim.messages.topics import NAMESPACE

    rules = [rule for word, rule in itertools.pairwise(ros) if word in ("-r", "--remap")]
    given = [rule.partition(":=")[2] for rule in rules if rule.startswith("__ns:=")]
    return given[0] if given else NAMESPACE


def _check(ros: Sequence[str]) -> None:
    for word, following in itertools.pairwise([*ros, ""]):
        if word in _PARAMETERS:
            raise FlockError(
                f"ROS argument {word} {following}: parameters go into --config FILE, or are options"
            )
        if word in ("-r", "--remap") and following.rpartition("/")[2].startswith(_RENAMES):
            raise FlockError(
                f"ROS argument {word} {following}: all nodes would have the same name; "
                "use __ns:= to move them to another namespace"
            )
    from flock_sim.ros.process import check_ros_arguments

    check_ros_arguments(ros)
