# SPDX-License-Identifier: Apache-2.0
"""The ROS arguments of tools that are not a single node."""

from __future__ import annotations

import pytest

from flock_sim.errors import FlockError
from flock_sim.ros.ros_arguments import namespace, split


@pytest.mark.parametrize(
    ("given", "own", "ros"),
    [
        (["--birds", "3"], ["--birds", "3"], []),
        (["--", "-r"], ["--", "-r"], []),
        (
            ["--birds", "3", "--ros-args", "-r", "__ns:=/left"],
            ["--birds", "3"],
            ["--ros-args", "-r", "__ns:=/left"],
        ),
        (
            ["--ros-args", "--log-level", "debug", "--", "--birds", "3"],
            ["--birds", "3"],
            ["--ros-args", "--log-level", "debug", "--"],
        ),
    ],
)
def test_ros_arguments_end_at_two_dashes(given: list[str], own: list[str], ros: list[str]) -> None:
    assert split(given) == (own, ros)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([], "/flock"),
        (["--ros-args", "-r", "__ns:=/left"], "/left"),
        (["--ros-args", "--remap", "__ns:=/a/b", "-r", "x:=y"], "/a/b"),
    ],
)
def test_the_namespace_is_that_of_the_rule(given: list[str], expected: str) -> None:
    assert namespace(given) == expected


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["-p", "birds:=3"], "parameters go into --config FILE"),
        (["--params-file", "flock.yaml"], "parameters go into --config FILE"),
        (["-r", "__node:=one"], "all nodes would have the same name"),
        (["-r", "__ns:=left"], "ROS arguments: "),
        (["--log-level", "loud"], "ROS arguments: "),
        (["--unknown"], "ROS arguments: "),
    ],
)
def test_arguments_that_no_flock_can_have_are_refused(given: list[str], words: str) -> None:
    with pytest.raises(FlockError, match=words):
        split(["--ros-args", *given])
