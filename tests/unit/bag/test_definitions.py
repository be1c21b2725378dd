# SPDX-License-Identifier: Apache-2.0
"""The embedded definitions are complete, in rosbag2's format, with the type's true hash."""

import json
import runpy
import sys
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from flock_sim.bag import definitions
from flock_sim.bag.definitions import copied_definition, installed_definition
from flock_sim.errors import FlockError
from flock_sim.messages.types import Message
from flock_tools.scene.messages import TRANSFORMS

ROOT = Path(__file__).parents[3]

TYPES = [
    *(f"flock_interfaces/msg/Bird{name}" for name in ("Wing", "Stage", "State")),
    "flock_interfaces/msg/Grant",
    "flock_interfaces/msg/Perturbation",
    "flock_interfaces/msg/Progress",
    "rosgraph_msgs/msg/Clock",
    "std_msgs/msg/Header",
    "std_msgs/msg/Float64MultiArray",
    "rcl_interfaces/msg/ParameterEvent",
]


@pytest.mark.parametrize("name", TYPES)
def test_rosbags_parses_the_text_and_computes_the_same_hash(name: str) -> None:
    definition = installed_definition(name)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition.text, name))
    assert store.hash_rihs01(name) == definition.type_hash


def test_copies_are_the_installed_definitions() -> None:
    expected = runpy.run_path(str(ROOT / "tools/message_definitions.py"))["all_definitions"]()
    copies = [copied_definition(definition.type) for definition in expected]
    assert copies == expected, "run `./flock python tools/message_definitions.py`"
    assert list(definitions._copies()) == [definition.type for definition in expected]


def test_the_definition_of_tf_which_has_no_wheel_is_that_of_ros() -> None:
    copy = copied_definition(TRANSFORMS)
    assert copy.type_hash == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(TRANSFORMS)


def test_without_ros_the_copies_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    types = sorted({kind.TYPE for kind in Message.__subclasses__()})
    installed = [installed_definition(name) for name in types]
    monkeypatch.setitem(sys.modules, "ament_index_python", None)
    assert [installed_definition(name) for name in types] == installed
    with pytest.raises(FlockError, match=r"std_msgs/msg/Header needs ROS 2"):
        installed_definition("std_msgs/msg/Header")


def test_nested_definitions_follow_in_rosbag2s_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def install(package: str, name: str, text: str) -> None:
        index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
        index.mkdir(parents=True, exist_ok=True)
        (index / package).touch()
        directory = tmp_path / "share" / package / "msg"
        directory.mkdir(parents=True, exist_ok=True)
        (directory / f"{name}.msg").write_text(text, encoding="utf-8")
        (directory / f"{name}.json").write_text(
            json.dumps(
                {"type_hashes": [{"type_name": f"{package}/msg/{name}", "hash_string": "RIHS01_1"}]}
            )
        )

    install("zoo", "Root", "# other/Comment\nFar[] far\nbirds/Wing[<=3] wings\nuint8 MAX=3\n")
    install("zoo", "Far", "string<=9 name\nbirds/Wing wing\n")
    install("birds", "Wing", "float64[2] span\nwstring note\nTip tip")
    install("birds", "Tip", "bool b\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    line = "=" * 80
    assert installed_definition("zoo/msg/Root").text == (
        "# other/Comment\nFar[] far\nbirds/Wing[<=3] wings\nuint8 MAX=3\n"
        f"\n{line}\nMSG: birds/Wing\nfloat64[2] span\nwstring note\nTip tip"
        f"\n{line}\nMSG: birds/Tip\nbool b\n"
        f"\n{line}\nMSG: zoo/Far\nstring<=9 name\nbirds/Wing wing\n"
    )


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("nowhere/msg/State", "nowhere/msg/State is not installed .*start through ./flock"),
        ("std_msgs/msg/Nothing", "std_msgs/msg/Nothing is not installed"),
        ("State", "not of the form package/msg/Type"),
        ("../../etc/passwd", "not of the form package/msg/Type"),
    ],
)
def test_a_type_that_is_not_there_is_refused_in_one_line(name: str, reason: str) -> None:
    with pytest.raises(FlockError, match=reason) as refused:
        installed_definition(name)
    assert "\n" not in str(refused.value)


def test_a_workspace_that_is_not_sourced_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    with pytest.raises(FlockError, match=r"source install/setup.bash"):
        installed_definition("std_msgs/msg/Header")
