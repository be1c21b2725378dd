# SPDX-License-Identifier: Apache-2.0
"""A smoke test for `colcon test`: the messages import, and have the bytes of their definitions."""

import struct
from importlib import import_module
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message

from flock_interfaces.msg import Progress

PACKAGE = Path(__file__).parents[1]


def test_all_messages_and_services_import() -> None:
    definitions = [*PACKAGE.glob("msg/*.msg"), *PACKAGE.glob("srv/*.srv")]
    assert definitions
    for path in definitions:
        assert getattr(import_module(f"flock_interfaces.{path.parent.name}"), path.stem)


def test_a_progress_message_has_the_bytes_of_cdr() -> None:
    values = {"run_id": 2**63 + 1, "step": -1, "epoch": 7, "who": "bird_02", "life": 5}
    # The encapsulation, the numbers, the text with its length and end, and `life` aligned to 8.
    data = bytes([0, 1, 0, 0]) + struct.pack(
        "<QqII8s0QQ", values["run_id"], -1, 7, len("bird_02") + 1, b"bird_02\0", 5
    )
    assert serialize_message(Progress(**values)) == data
    assert deserialize_message(data, Progress) == Progress(**values)
