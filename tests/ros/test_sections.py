# SPDX-License-Identifier: Apache-2.0
"""Sections of parameter files have the same meaning for Flock's nodes as for any ROS 2 node."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from random import Random
from typing import Any

import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.node import Node

from flock_sim.configuration import parameter_file
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.ros.log import ros_context
from flock_sim.ros.parameters.given import parameter_reader, what_is_given
from support.terminal import Terminal

ALL = "/**"


def written(path: Path, found: dict[str, dict[str, Any]]) -> Path:
    """A parameter file with these sections, in this order."""
    text = {name: {"ros__parameters": parameters} for name, parameters in found.items()}
    path.write_text(yaml.safe_dump(text, sort_keys=False), encoding="utf-8")
    return path


def given(name: str, *arguments: str | Path) -> tuple[FlockConfiguration, dict[str, Any]]:
    """What a node process with these ROS arguments is told; `context` sees to the environment."""
    words = ["--ros-args", "--disable-external-lib-logs", *map(str, arguments)]
    context = ros_context(words, quiet=False)
    try:
        with parameter_reader(name, context) as reader:
            return what_is_given(name, reader, words)
    finally:
        rclpy.try_shutdown(context=context)


def by_file(path: Path, found: dict[str, dict[str, Any]]) -> list[str | Path]:
    return ["--params-file", written(path, found)]


def test_wildcards_match_as_those_of_rclpy(context: Context, tmp_path: Path) -> None:
    random = Random(16)
    names = ["/flock/*", "/*/bird_03", "/**/bird_03", "/flock/**", "/*", "/other/*", "/**/*"]
    for number in range(20):
        # In the order in which it does not matter whether a node's own section wins, or the last.
        drawn = [ALL, *random.sample(names, 4), "/flock/bird_03"]
        values = {
            name: {key: random.randint(1, 99) for key in random.sample("abcdef", 3)}
            for name in drawn
        }
        file = written(tmp_path / f"{number}.yaml", values)
        node = Node(
            "bird_03",
            namespace="/flock",
            context=context,
            cli_args=["--ros-args", "--params-file", str(file)],
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
            automatically_declare_parameters_from_overrides=True,
        )
        told = {name: one.value for name, one in node.get_parameters_by_prefix("").items()}
        node.destroy_node()
        ours = parameter_file.sections(file).of("/flock/bird_03")
        assert ours == {key: value for key, value in told.items() if len(key) == 1}, values


@pytest.mark.usefixtures("context")
def test_the_section_of_the_clock_is_for_the_clock(tmp_path: Path) -> None:
    found = {ALL: {"birds": 3, "t_max": 50.0}, "/flock/clock": {"window": 1}}
    file = by_file(tmp_path / "f.yaml", found)
    for name, window in (("clock", 1), ("recorder", 64), ("bird", 64)):
        configuration, operation = given(name, "-p", "index:=1", *file)
        assert (configuration.birds, configuration.t_max) == (3, 50.0)
        assert operation["window"] == window, name


@pytest.mark.usefixtures("context")
@pytest.mark.parametrize("section", ["/flock/bird_03", "/flock/*", "/**/bird_03", "/*/bird_03"])
def test_the_section_of_a_bird_is_for_that_bird(tmp_path: Path, section: str) -> None:
    file = by_file(tmp_path / "f.yaml", {section: {"birds": 3, "t_max": 50.0, "timeout": 7.0}})
    configuration, operation = given("bird", "-p", "index:=3", *file)
    assert (configuration.birds, configuration.t_max, operation["timeout"]) == (3, 50.0, 7.0)
    configuration, operation = given("bird", "-p", "index:=2", *file)
    expected = (3, 7.0) if section == "/flock/*" else (13, 600.0)
    assert (configuration.birds, operation["timeout"]) == expected


@pytest.mark.usefixtures("context")
def test_what_is_given_by_itself_wins_over_all_sections(tmp_path: Path) -> None:
    found = {ALL: {"birds": 3}, "/flock/clock": {"birds": 4, "window": 2, "run_id": 5}}
    file = by_file(tmp_path / "f.yaml", found)
    configuration, operation = given("clock", *file, "-p", "window:=9", "--param", "birds:=6")
    assert (configuration.birds, operation["window"], operation["run_id"]) == (6, 9, 5)


@pytest.mark.usefixtures("context")
def test_a_node_with_another_name_has_the_section_of_that(tmp_path: Path) -> None:
    found = {"/flock/clock": {"window": 2}, "/flock/time": {"window": 3}, "/a/clock": {"window": 4}}
    file = by_file(tmp_path / "f.yaml", found)
    assert given("clock", *file, "-r", "__node:=time")[1]["window"] == 3
    assert given("clock", *file, "-r", "__ns:=/a")[1]["window"] == 4


@pytest.mark.usefixtures("context")
def test_a_section_of_no_node_is_no_error_and_an_unknown_key_is(tmp_path: Path) -> None:
    other = {"/camera/driver": {"exposure": 3}, "/flock/bird_09": {"no": 1}}
    assert given("clock", *by_file(tmp_path / "a.yaml", other))[0] == FlockConfiguration()
    bad = by_file(tmp_path / "b.yaml", {"/flock/clock": {"windows": 1}})
    with pytest.raises(FlockError, match=r"'windows': did you mean 'window'.* for /flock/clock"):
        given("clock", *bad)


@pytest.mark.usefixtures("context")
def test_quality_of_service_of_what_flock_says_can_t_be_overridden(tmp_path: Path) -> None:
    def override(topic: str, kind: str) -> dict[str, dict[str, Any]]:
        return {"/flock/clock": {"qos_overrides": {topic: {kind: {"depth": 1}}}}}

    for number, (topic, kind) in enumerate(
        [("/clock", "publisher"), ("/flock/progress", "subscription"), ("/flock/x", "publisher")]
    ):
        file = by_file(tmp_path / f"{number}.yaml", override(topic, kind))
        with pytest.raises(FlockError, match=f"qos_overrides.{topic}.{kind}.depth.*leave it out"):
            given("clock", *file)
    given("clock", *by_file(tmp_path / "tf.yaml", override("/tf", "subscription")))


def dump(name: str, context: Context, arguments: Sequence[str | Path]) -> dict[str, Any]:
    """What `ros2 param dump` writes of a node that was started so, as far as it says it."""
    configuration, operation = given(name, *arguments)
    own = {"bird": ("index",), "clock": ("window", "record", "record_stages"), "recorder": ()}
    keys = (*own[name], "run_id", "timeout", "executor", "real_time_factor")
    lists = {key: value or [""] for key, value in configuration.parameters().items()}
    return {
        **lists,
        **{key: operation[key] for key in keys},
        "start_type_description_service": True,
        "use_sim_time": False,
    }


@pytest.mark.parametrize("name", ["clock", "recorder", "bird"])
def test_what_was_dumped_of_a_node_is_what_another_is_given(
    context: Context, tmp_path: Path, name: str
) -> None:
    first = ["-p", "birds:=3", "-p", "t_max:=50.0", "-p", "timeout:=9.0", "-p", "executor:=single"]
    first += ["-p", "index:=2", "-p", "window:=5"]
    full = "/flock/bird_02" if name == "bird" else f"/flock/{name}"
    dumped = dump(name, context, first)
    configuration, operation = given(name, *by_file(tmp_path / "d.yaml", {full: dumped}))
    assert configuration == FlockConfiguration(birds=3, t_max=50.0)
    assert {key: operation[key] for key in dumped if key in operation} == {
        key: value for key, value in dumped.items() if key in operation
    }


@pytest.mark.usefixtures("context")
def test_birds_of_one_process_fly_one_flock(tmp_path: Path) -> None:
    several = ["-p", "indices:=[1, 2, 3]", "-p", "birds:=3"]
    quick = by_file(tmp_path / "a.yaml", {"/flock/bird_03": {"timeout": 7.0}})
    _, operation = given("bird", *several, *quick)
    assert (operation["timeout"], operation["indices"]) == (7.0, [1, 2, 3])
    other = by_file(tmp_path / "b.yaml", {"/flock/bird_03": {"dt": 0.5}})
    with pytest.raises(
        FlockError, match=r"/flock/bird_03 has dt = 0.5 and the other nodes have 1.0"
    ):
        given("bird", *several, *other)
    wrong = by_file(tmp_path / "c.yaml", {"/flock/bird_03": {"index": 2}})
    with pytest.raises(FlockError, match=r"index = 2 \(in a section for /flock/bird_03\)"):
        given("bird", "-p", "indices:=[3]", *wrong)


def test_nodes_started_by_hand_obey_their_sections(terminal: Terminal) -> None:
    found = {
        ALL: {"birds": 2, "t_max": 50.0},
        "/flock/clock": {"record": False, "window": 1},
        "/flock/bird_02": {"dt": 0.5},
    }
    file = written(terminal.directory / "f.yaml", found)
    words = ["--ros-args", "--params-file", file]
    clock = terminal.start("clock", *words).until_connected()
    first = terminal.start("bird", *words, "-p", "index:=1")
    done = terminal.run("bird", *words, "-p", "index:=2")
    assert done.status == 2
    assert "bird_02 has dt = 0.5 where the clock has 1.0" in done.error
    assert terminal.run("bird", *words, "-p", "index:=2", "-p", "dt:=1.0").status == 0
    assert [job.wait().status for job in (clock, first)] == [0, 0]


def test_fly_starts_its_nodes_with_what_their_sections_say(terminal: Terminal) -> None:
    found = {
        ALL: {"birds": 3, "t_max": 50.0},
        "/flock/clock": {"window": 1},
        "/**/bird_03": {"executor": "single", "timeout": 20.0},
        "/flock/recorder": {"output": "bag", "timeout": 9.0},
    }
    file = written(terminal.directory / "f.yaml", found)
    terminal.well("fly", "--config", file, "--processes", "3")
    done = terminal.run("reference", "--config", file, "--output", "reference")
    assert "skipped: /flock/clock, /**/bird_03, /flock/recorder" in done.stderr
    terminal.well("compare", "bag", "reference")
