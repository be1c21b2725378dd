# SPDX-License-Identifier: Apache-2.0
"""The output of tools, the places of their files, and the precedence of values."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import struct
import termios
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader

from support.terminal import TOOLS, Terminal

METRICS = {
    "birds", "members", "coupling", "dt", "steps", "t_final", "leader",
    "mean_speed", "speed_std", "stable", "spacing", "position", "lateral",
    "drag_reduction", "mean_drag_reduction", "hierarchical", "profile_error",
}  # fmt: skip
FLIGHT = {"steps_per_second", "wall_seconds", "output"}
SHORT = ("--birds", "3", "--t-max", "40")


def refuse_constant(name: str) -> Any:
    raise AssertionError(f"{name} is not JSON")


def one_object(text: str) -> dict[str, Any]:
    """The JSON object that is all of `text`."""
    assert text.count("\n") == 1
    assert text.endswith("\n")
    value = json.loads(text, parse_constant=refuse_constant)
    assert isinstance(value, dict)
    return value


@pytest.mark.parametrize("tool", ["fly", "reference"])
def test_json_is_all_there_is_on_stdout_and_has_the_keys_of_the_contract(
    terminal: Terminal, tool: str
) -> None:
    flock = ("--birds", 4, "--span-ratio", "2=0.98,1.0,1.02", "--t-max", 40)
    value = one_object(terminal.well(tool, *flock, "--output", "bag", "--json").stdout)
    assert value.keys() >= METRICS | FLIGHT
    assert (value["birds"], value["members"], value["coupling"]) == (4, 3, "nearest")
    assert (value["dt"], value["steps"], value["t_final"], value["leader"]) == (1.0, 40, 40.0, 3)
    for key in ("mean_speed", "speed_std", "stable", "hierarchical", "mean_drag_reduction"):
        assert len(value[key]) == 3, key
    for key in ("position", "lateral", "drag_reduction"):
        assert [len(member) for member in value[key]] == [4, 4, 4], key
    assert [len(member) for member in value["spacing"]] == [3, 3, 3]
    assert value["profile_error"] == [None, None, None]
    assert value["output"] == "bag"
    assert value["steps_per_second"] > 0.0
    assert value["wall_seconds"] > 0.0
    measured = one_object(terminal.well("metrics", "bag", "--json").stdout)
    assert measured == {key: value[key] for key in measured}
    early = one_object(terminal.well("metrics", "bag", "--json", "--at", 20).stdout)
    assert (early["steps"], early["t_final"]) == (20, 20.0)


def test_a_flight_without_a_bag_leaves_none(terminal: Terminal) -> None:
    value = one_object(terminal.well("fly", *SHORT, "--no-record", "--json").stdout)
    assert value.keys() >= FLIGHT
    assert value["output"] is None
    assert list(terminal.directory.iterdir()) == []


def test_compare_prints_its_keys(terminal: Terminal) -> None:
    terminal.well("reference", *SHORT, "--output", "one")
    terminal.well("reference", *SHORT, "--output", "other", "--coupling", "all")
    same = terminal.run("compare", "one", "one", "--json")
    other = terminal.run("compare", "one", "other", "--json")
    assert (same.status, other.status) == (0, 1)
    for done, equal in ((same, True), (other, False)):
        value = one_object(done.stdout)
        assert value.keys() >= {"equal", "messages", "first_difference", "max_difference"}
        assert value["equal"] is equal
        assert value["messages"] == 3 * 5
        assert value["max_difference"].keys() == {
            "position", "speed", "circulation", "interaction_drag",
        }  # fmt: skip
    assert terminal.run("compare", "one", "other", "--tolerance", 1e9).status == 1  # not coupled so


@pytest.mark.parametrize("tool", TOOLS)
def test_help_shows_examples_and_exits_0(terminal: Terminal, tool: str) -> None:
    done = terminal.well(tool, "--help")
    assert done.stderr == ""
    assert done.stdout.startswith("usage: ")
    examples = done.stdout.partition("examples:\n")[2]
    assert f"flock {tool}" in examples
    assert max(map(len, examples.splitlines())) <= 100


def flown(bag: Path) -> dict[str, Any]:
    """The configuration that a bag holds."""
    with (bag / f"{bag.name}_0.mcap").open("rb") as file:
        (record,) = [m for m in make_reader(file).iter_metadata() if m.name == "flock"]
    return {key: json.loads(value) for key, value in record.metadata.items()}


def test_flags_win_over_the_file_and_the_file_over_the_defaults(terminal: Terminal) -> None:
    file = terminal.directory / "flock.yaml"
    file.write_text(
        "/**:\n"
        "  ros__parameters:\n"
        "    birds: 4\n"
        "    coupling: all\n"
        "    t_max: 2e1\n"  # YAML 1.1 reads this as text
        "    record_every: 5\n"
        "    cruise_speed: 19.0\n"
        '    span_ratios: ["2=1.1"]\n'
    )
    flags = ("--config", file, "--birds", 3, "--t-max", "1e1", "--span-ratio", "1=0.9")
    terminal.well("reference", *flags, "--output", "by-reference")
    terminal.well("fly", *flags, "--output", "by-fly")
    terminal.well("reference", "--config", file, "--output", "by-file")
    value = flown(terminal.directory / "by-fly")
    assert value == flown(terminal.directory / "by-reference")
    assert (value["birds"], value["t_max"], value["span_ratios"]) == (3, 10.0, ["1=0.9"])  # flags
    assert (value["coupling"], value["record_every"], value["cruise_speed"]) == ("all", 5, 19.0)
    assert (value["dt"], value["wing_span"], value["aspect_ratio"]) == (1.0, 1.5, 9.0)  # defaults
    by_file = flown(terminal.directory / "by-file")
    assert (by_file["birds"], by_file["t_max"], by_file["span_ratios"]) == (4, 20.0, ["2=1.1"])
    assert terminal.run("compare", "by-fly", "by-reference").status == 0


def test_the_defaults_are_those_of_the_contract(terminal: Terminal) -> None:
    terminal.well("reference", "--output", "bag")
    value = flown(terminal.directory / "bag")
    value.pop("flock_version")
    assert value == {
        "birds": 13, "coupling": "nearest", "dt": 1.0, "t_max": 10000.0, "record_every": 10,
        "body_mass": 3.8, "wing_span": 1.5, "air_density": 1.225, "min_drag_speed": 18.0,
        "cruise_speed": 18.5, "oswald_efficiency": 0.8, "zero_lift_drag": 0.025,
        "aspect_ratio": 9.0, "span_ratios": [], "perturbations": [],
    }  # fmt: skip


def test_an_existing_bag_is_replaced_only_by_force(terminal: Terminal) -> None:
    terminal.well("reference", *SHORT, "--output", "bag")
    before = (terminal.directory / "bag" / "bag_0.mcap").read_bytes()
    for tool in ("reference", "fly"):
        done = terminal.run(tool, "--birds", 2, "--t-max", 40, "--output", "bag")
        assert done.status == 2
        assert "--force" in done.error
        assert (terminal.directory / "bag" / "bag_0.mcap").read_bytes() == before
    terminal.well("fly", "--birds", 2, "--t-max", 40, "--output", "bag", "--force")
    assert flown(terminal.directory / "bag")["birds"] == 2
    assert {file.name for file in (terminal.directory / "bag").iterdir()} == {
        "bag_0.mcap", "metadata.yaml",
    }  # fmt: skip
    information = yaml.safe_load((terminal.directory / "bag" / "metadata.yaml").read_text())
    assert information["rosbag2_bagfile_information"]["relative_file_paths"] == ["bag_0.mcap"]


def test_without_an_output_a_bag_of_its_own_is_made_below_runs(terminal: Terminal) -> None:
    output = terminal.well("reference", *SHORT, "--json").json["output"]
    assert re.fullmatch(r"runs/reference-\d{8}-\d{6}", output)
    assert (terminal.directory / output / "metadata.yaml").exists()


@pytest.mark.parametrize("tool", ["fly", "reference"])
def test_progress_is_shown_on_a_terminal_and_nowhere_else(terminal: Terminal, tool: str) -> None:
    flight = ("--birds", 2, "--t-max", 1000, "--json", "--output", "bag", "--force")
    quiet = terminal.well(tool, *flight)
    assert quiet.stderr.splitlines() == ["recording to bag"]

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 160, 0, 0))
    job = terminal.start(tool, *flight, stderr=theirs)
    os.close(theirs)
    shown = b""
    while True:
        try:
            piece = os.read(ours, 65536)
        except OSError:  # the terminal's other end is closed: all is said
            break
        shown += piece
    os.close(ours)
    done = job.wait()
    assert done.status == 0
    one_object(done.stdout)
    text = re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", shown).decode()
    assert "step 1000/1000" in text
    assert "t = 1000" in text
    assert re.search(r"\d+ steps/s", text)


def test_steps_beyond_the_last_record_are_told(terminal: Terminal) -> None:
    done = terminal.well("reference", "--birds", 1, "--t-max", 25, "--output", "bag")
    assert "last 5 steps" in done.stderr
    assert "divides 25" in done.stderr


@pytest.mark.parametrize("words", [("bag",), ("bag", "--json"), ("--help",)])
def test_a_reader_that_has_enough_is_no_error(terminal: Terminal, words: tuple[str, ...]) -> None:
    terminal.well("reference", *SHORT, "--output", "bag")
    reading, writing = os.pipe()
    os.close(reading)
    job = terminal.start("metrics", *words, stdout=writing)
    os.close(writing)
    done = job.wait()
    assert done.stderr == ""
    assert done.status == 141


def test_results_that_cannot_be_written_are_an_error_in_one_line(terminal: Terminal) -> None:
    terminal.well("reference", *SHORT, "--output", "bag")
    with open("/dev/full", "wb") as full:
        done = terminal.start("metrics", "bag", stdout=full).wait()
    assert done.status == 1
    assert done.stderr == "error: standard output can't be written: No space left on device\n"
