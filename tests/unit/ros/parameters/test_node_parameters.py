# SPDX-License-Identifier: Apache-2.0
"""A parameter file has the same meaning for nodes of `fly` and launches as for any node."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from flock_sim.commands.fly import _options, _plan
from flock_sim.commands.fly import tool as fly
from flock_sim.commands.reference import tool as reference
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.operation import parted
from flock_sim.errors import FlockError
from flock_sim.launcher.flight import Plan
from flock_sim.launcher.ros2_launch_arguments import ARGUMENTS, Arguments
from flock_sim.ros.parameters.node_parameters import together
from flock_tools.commands.equilibrium import tool as equilibrium
from support.tool_runs import error_of

ALL = "/**"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "flock.yaml"


def write(file: Path, found: dict[str, dict[str, Any]]) -> None:
    text = {name: {"ros__parameters": parameters} for name, parameters in found.items()}
    file.write_text(yaml.safe_dump(text, sort_keys=False), encoding="utf-8")


def planned(file: Path, *options: str) -> Plan:
    return _plan(_options(["--config", str(file), *options]), None)


def refused(file: Path, *options: str) -> str:
    with pytest.raises(FlockError) as caught:
        planned(file, *options)
    message = str(caught.value)
    assert "\n" not in message
    assert str(file) in message
    return message


def test_fly_obeys_the_section_of_its_clock(file: Path) -> None:
    write(file, {ALL: {"birds": 3, "t_max": 50.0}, "/flock/clock": {"window": 1, "timeout": 8}})
    plan = planned(file)
    assert (plan.configuration.birds, plan.window, plan.timeout) == (3, 1, 8.0)
    plan = planned(file, "--window", "5", "--timeout", "9", "--birds", "4")
    assert (plan.configuration.birds, plan.window, plan.timeout) == (4, 5, 9.0)


def test_fly_gives_birds_and_recorder_what_their_sections_say(file: Path) -> None:
    found = {
        ALL: {"birds": 3, "t_max": 50.0, "executor": "single"},
        "/flock/bird_03": {"timeout": 7.0},
        "/flock/recorder": {"executor": "events", "output": "runs/told", "record_stages": True},
    }
    write(file, found)
    plan = planned(file)
    assert plan.executor == "single"
    assert plan.record_stages
    assert plan.output == Path("runs/told")
    assert plan.operation(["bird_01", "bird_02"]) == {"executor": "single"}
    assert plan.operation(["bird_02", "bird_03"]) == {"executor": "single", "timeout": 7.0}
    assert plan.operation(["recorder"]) == {"executor": "events"}
    plan = planned(file, "--executor", "events", "--timeout", "3", "--output", "mine")
    assert plan.operation(["bird_03"]) == plan.operation(["recorder"]) == {}
    assert (plan.executor, plan.output) == ("events", Path("mine"))


def test_fly_without_a_file_is_as_before() -> None:
    plan = _plan(_options(["--birds", "3"]), None)
    assert (plan.window, plan.timeout, plan.executor, plan.record_stages) == (64, 60.0, "events", 0)
    assert plan.operation(["bird_03"]) == {}


def test_the_longest_timeout_is_one_that_nodes_take(file: Path) -> None:
    write(file, {})
    others = planned(file, "--timeout", "1e9").timeout_of_others
    assert parted({"timeout": others}) == ({}, {"timeout": 1e9})


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (
            {ALL: {"birds": 3}, "/flock/bird_03": {"dt": 0.5}},
            [
                "/flock/bird_03",
                "dt = 0.5",
                "the other nodes have 1.0",
                "out of section /flock/bird_03",
            ],
        ),
        (
            {"/flock/bird_03": {"birds": 3, "t_max": 50.0}},
            ["/flock/bird_03", "birds = 3", "the other nodes have 13"],
        ),
        (
            {"/flock/clock": {"birds": 3}},
            ["/flock/recorder", "birds = 13", "the other nodes have 3", "give it in section /**"],
        ),
        (
            {ALL: {"birds": 3}, "/**/bird_02": {"span_ratios": ["1=1.1"]}},
            ["/flock/bird_02", "span_ratios", "out of section /**/bird_02"],
        ),
        ({"/flock/bird_03": {"timeot": 7.0}}, ["'timeot'", "'timeout'", "for /flock/bird_03"]),
        ({"/flock/recorder": {"timeout": -7.0}}, ["timeout -7.0", "for /flock/recorder"]),
        ({ALL: {"windows": 1}}, ["'windows'", "did you mean 'window'"]),
        (
            {"/flock/bird_02": {"executor": "single"}, "/flock/bird_01": {"executor": "events"}},
            ["executor", "/flock/bird_02", "separate processes"],
        ),
        (
            {"/flock/clock": {"qos_overrides": {"/clock": {"publisher": {"depth": 1}}}}},
            ["qos_overrides./clock.publisher.depth", "leave it out"],
        ),
        ({"/flock/clock": {"real_time_factor": 2.0}}, ["real_time_factor = 2", "--mode free"]),
    ],
)
def test_fly_refuses_what_its_nodes_would(
    file: Path, found: dict[str, dict[str, Any]], words: list[str]
) -> None:
    write(file, found)
    message = refused(file)
    assert [word for word in words if word not in message] == [], message


def test_all_nodes_may_be_told_the_same_each_by_itself(file: Path) -> None:
    nodes = ["/flock/clock", "/flock/recorder", *(f"/flock/bird_0{k}" for k in (1, 2, 3))]
    flown = {"birds": 3, "t_max": 50.0, "span_ratios": [""], "use_sim_time": False}
    write(file, {node: flown for node in nodes})
    assert planned(file).configuration == FlockConfiguration(birds=3, t_max=50.0)
    write(file, {nodes[4]: flown})
    plan = planned(file, "--birds", "3", "--t-max", "50")  # options win over all sections
    assert plan.configuration == FlockConfiguration(birds=3, t_max=50.0)


def test_what_fly_does_not_read_is_named(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = {
        ALL: {"birds": 3, "use_sim_time": True},
        "/flock/bird_09": {"timeout": 1.0},
        "/camera": {"exposure": 3},
        "/flock/clock": {"run_id": 7, "index": 0},
    }
    write(file, found)
    planned(file)
    assert capsys.readouterr().err.splitlines() == [
        f"note: {file}: no node of this flight matches section /flock/bird_09, /camera",
        f"note: {file}: only nodes that are started by hand use run_id",
    ]


def test_a_file_that_is_refused_costs_no_bag(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(file, {"/flock/bird_03": {"dt": 0.5}})
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "kept").touch()
    told = error_of(fly, capsys, "--config", str(file), "--output", str(bag), "--force")
    assert "/flock/bird_03 has dt = 0.5" in told
    assert (bag / "kept").exists()


def test_tools_without_nodes_read_what_is_for_all(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = {"birds": 3, "t_max": 4.0, "window": 1, "use_sim_time": True, "executor": "single"}
    write(file, {ALL: common, "/flock/bird_03": {"dt": 0.5}, "/flock/clock": {"window": 1}})
    skipped = f"{file}: only the section /** is read; skipped: /flock/bird_03, /flock/clock"
    output = tmp_path / "bag"
    assert reference(["--config", str(file), "--output", str(output)]) == 0
    assert f"note: {skipped}\n" in capsys.readouterr().err
    assert equilibrium(["--config", str(file)]) in (0, 1)
    assert f"note: {skipped}\n" in capsys.readouterr().err
    write(file, {ALL: {**common, "windw": 1}})
    assert "'windw': did you mean 'window'" in error_of(reference, capsys, "--config", str(file))


def test_a_process_waits_as_long_as_its_least_patient_node() -> None:
    told = {"/a": {"timeout": 9.0}, "/b": {"timeout": 7.0, "executor": "single"}, "/c": {}}
    assert together(told) == {"timeout": 7.0, "executor": "single"}


DEFAULTS = {name: default for name, (default, _) in ARGUMENTS.items()}


def test_a_launch_refuses_a_section_of_another_flock_and_records_where_the_file_says(
    file: Path,
) -> None:
    write(file, {ALL: {"birds": 3}, "/flock/recorder": {"output": "told"}, "/flock/*": {"dt": 0.5}})
    told = Arguments.read({**DEFAULTS, "config": str(file)})
    assert (told.configuration.dt, told.output) == (0.5, "told")
    assert Arguments.read({**DEFAULTS, "config": str(file), "output": "x"}).output == "x"
    write(file, {ALL: {"birds": 3}, "/flock/bird_02": {"dt": 0.5}})
    with pytest.raises(FlockError, match=r"/flock/bird_02 has dt = 0.5") as refusal:
        Arguments.read({**DEFAULTS, "config": str(file)})
    assert f"config:={file}" in str(refusal.value)
