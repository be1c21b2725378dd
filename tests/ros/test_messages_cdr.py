# SPDX-License-Identifier: Apache-2.0
"""Flock's own CDR code and that of ROS 2 agree bit for bit, in both directions."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock

from flock_interfaces.msg import (
    BirdAges,
    BirdMemory,
    BirdStage,
    BirdState,
    BirdWing,
    Checkpoint,
    Grant,
    Perturbation,
    Progress,
)
from flock_sim.messages import types as messages
from flock_sim.messages.stage_layout import stage_bytes, stage_numbers, stage_words

KINDS = {
    "Q": st.integers(0, 2**64 - 1),
    "q": st.integers(-(2**63), 2**63 - 1),
    "I": st.integers(0, 2**32 - 1),
    "i": st.integers(-(2**31), 2**31 - 1),
    "B": st.integers(0, 255),
    "d": st.floats(allow_nan=False),
    "text": st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20),
    "numbers": st.lists(st.floats(allow_nan=False), max_size=20).map(np.array),
}

FIELDS = {
    messages.Wing: (BirdWing, ["run_id", "bird", "span_ratio"]),
    messages.Stage: (
        BirdStage,
        ["run_id", "step", "epoch", "bird", "stage", "position", "speed", "circulation"],
    ),
    messages.State: (
        BirdState,
        [
            "header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "step", "time",
            "position", "speed", "circulation", "interaction_drag", "mean_speed",
            "mean_interaction_drag", "forcing_state", "run_id", "epoch",
        ],
    ),
    messages.Grant: (
        Grant, ["run_id", "step", "end", "dt", "epoch", "terms", "perturbation"],
    ),
    messages.Progress: (Progress, ["run_id", "step", "epoch", "who", "life"]),
    messages.Checkpoint: (
        Checkpoint,
        [
            "run_id", "step", "epoch", "position", "speed", "perturbations", "memory",
            "forcing_state",
        ],
    ),
    messages.Memory: (BirdMemory, ["run_id", "step", "epoch", "bird", "data"]),
    messages.Ages: (
        BirdAges,
        ["run_id", "step", "epoch", "bird", "age", "age_max", "behind", "late", "lateness"],
    ),
    messages.Push: (
        Perturbation, ["run_id", "step", "position", "speed", "number", "bird", "member"],
    ),
    messages.Time: (Clock, ["clock.sec", "clock.nanosec"]),
}  # fmt: skip
"""The ROS type of each message, and where its fields are in it, in order."""


def as_ros(message: messages.Message) -> Any:
    """The message as rclpy has it."""
    kind, names = FIELDS[type(message)]
    made = kind()
    for name, field in zip(names, fields(message), strict=True):
        value = getattr(message, field.name)
        *path, last = name.split(".")
        place = made
        for part in path:
            place = getattr(place, part)
        setattr(place, last, value.tolist() if isinstance(value, np.ndarray) else value)
    return made


@pytest.mark.parametrize("kind", FIELDS)
@given(data=st.data())
def test_each_reads_what_the_other_wrote(kind: type[messages.Message], data: st.DataObject) -> None:
    message = kind(*(data.draw(KINDS[k]) for k in kind.KINDS))
    ros, ours = as_ros(message), message.encode()
    theirs = serialize_message(ros)
    assert deserialize_message(ours, FIELDS[kind][0]) == ros
    # Not theirs == ours: what rclpy leaves between fields, and after the last, is left to chance.
    assert kind.decode(theirs).encode() == ours
    assert len(theirs) >= len(ours)


@pytest.mark.parametrize("kind", FIELDS)
def test_the_type_is_named_as_ros_names_it(kind: type[messages.Message]) -> None:
    ros = FIELDS[kind][0]
    package = ros.__module__.partition(".")[0]
    assert f"{package}/msg/{ros.__name__}" == kind.TYPE


@given(
    header=st.tuples(*(KINDS[k] for k in "QQIIB")),
    rows=st.integers(1, 20).flatmap(
        lambda members: st.lists(
            st.lists(KINDS["d"], min_size=members, max_size=members), min_size=3, max_size=3
        )
    ),
)
def test_a_stage_where_it_lies_is_what_ros_reads(
    header: tuple[int, ...], rows: list[list[float]]
) -> None:
    members = len(rows[0])
    stage = messages.Stage(*header, *map(np.array, rows))
    cdr = serialize_message(as_ros(stage))
    words = np.zeros(stage_words(members))
    data = stage_bytes(words, members)
    data[:] = cdr[: len(data)]
    run_id, step, epoch, bird, number, count = messages.Stage.header(bytes(data))
    assert (run_id, step, epoch, bird, number, count) == (*header, members)
    assert [row.tolist() for row in stage_numbers(words, members)] == rows
