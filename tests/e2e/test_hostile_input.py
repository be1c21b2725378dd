# SPDX-License-Identifier: Apache-2.0
"""Hostile, damaged and odd input gives one line that controls no terminal, and exit status 2.

The tools are called in this process. An exception that no tool has foreseen is raised there.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import Writer

from flock_sim.commands import reference
from flock_sim.console.arguments import run_tool
from flock_sim.recording.flight_bag import CONFIGURATION_RECORD
from flock_tools.commands import (
    arrange,
    compare,
    limits,
    metrics,
    picture,
    repair,
    report,
    response,
    survey,
    sweep,
)
from support.hanging import not_hanging
from support.tool_runs import Tool, error_of, text_of

TITLE = "\x1b]0;x\x07"
"""A sequence that changes the title of a terminal."""

SHOWN = r"\x1b]0;x\x07"

SHORT = ("--birds", "2", "--t-max", "20")

Refused = Callable[..., str]


@pytest.fixture
def refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Refused:
    """Run a tool on bad input, and return its line, which is printable and not long."""
    monkeypatch.chdir(tmp_path)

    def run(tool: Tool, *arguments: str) -> str:
        with not_hanging():
            line = error_of(tool, capsys, *arguments)
        assert line[:-1].isprintable()
        assert len(line) < 5000
        return line

    return run


PARAMETERS = {
    "nested YAML": ("birds: " + "[" * 100_000, "line 3: is nested too deep"),
    "nested maps": ("birds: " + "{a: " * 100_000, "line 3: is nested too deep"),
    "tag of a number": ("birds: !!int zz", "line 3: tag !!int"),
    "tag of a bool": ("birds: !!bool zz", "line 3: tag !!bool"),
    "tag of a time": ("birds: !!timestamp zz", "line 3: tag !!timestamp"),
    "date": ("birds: 2001-01-01", "birds = '2001-01-01': must be a number"),
    "time": ("t_max: 2001-01-01 10:00:00", "must be a number"),
    "sexagesimal number": ("birds: 1:30", "birds = '1:30': must be a number"),
    "digits": ("birds: " + "9" * 5000, "line 3: a number with too many digits"),
    "digits as text": (f'birds: "{"9" * 5000}"', "must be a"),
    "bytes": ("birds: !!binary aGFsbG8=", "line 3: tag !!binary"),
    "set": ("span_ratios: !!set {a, b}", "line 3: tag !!set"),
    "null": ("birds: ~", "birds = None: must be a number"),
    "number of links": ("links: 20", "links = 20: must be a list such as"),
    "infinite whole number": ("record_every: .inf", "must be a whole number"),
    "keys": ("\n    ".join(f"k{k}: 1" for k in range(250_000)), "more than 500000 values"),
    "entries": (f"span_ratios: [{'a, ' * 500_000}]", "more than 500000 values"),
    "members": (f'span_ratios: ["4={"1," * 1_000_000}1"]', "13 birds x 1000001 members"),
    "control characters in a key": (r'"\e]0;x\a": 1', f"unknown parameter '{SHOWN}'"),
    "control characters in a value": (r'birds: "\e]0;x\a"', f"birds = '{SHOWN}'"),
    "control characters in a law": (r'forcing: ["\e]0;x\a.py:pull"]', f"law file {SHOWN}.py"),
    "control characters in a link": (r'links: ["\e]0;x\a"]', f"unknown model '{SHOWN}'"),
    "control characters in an entry": (r'span_ratios: ["\e]0;x\a"]', f"span ratio '{SHOWN}'"),
    "null character in a path": (r'forcing: ["a\0.py:pull"]', "its name is invalid"),
    "long path": (f'forcing: ["{"x" * 300}.py:pull"]', "File name too long"),
    "long value": (f"coupling: {'x' * 1_000_000}", "known are nearest, all"),
}


@pytest.mark.parametrize("kind", PARAMETERS)
def test_a_hostile_parameter_file_is_refused(refused: Refused, tmp_path: Path, kind: str) -> None:
    entry, said = PARAMETERS[kind]
    (tmp_path / "flock.yaml").write_text(f"/**:\n  ros__parameters:\n    {entry}\n")
    line = refused(reference.tool, "--config", "flock.yaml")
    assert said in line
    assert "configuration file flock.yaml" in line


SECTIONS = {
    "alias bomb": (
        "a: &a [x, x, x, x, x, x, x, x, x, x]\n"
        + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 10)}]\n" for a, b in zip("abcdef", "bcdefg")),
        "line 6: has more than 500000 values",
    ),
    "control characters in a section": (r'"\e]0;x\a": {}', SHOWN),
    "control characters in a section below": (r'/**: {"\e]0;x\a": {}}', SHOWN),
}


@pytest.mark.parametrize("kind", SECTIONS)
def test_a_file_with_hostile_sections_is_refused(
    refused: Refused, tmp_path: Path, kind: str
) -> None:
    text, said = SECTIONS[kind]
    (tmp_path / "flock.yaml").write_text(text)
    assert said in refused(reference.tool, "--config", "flock.yaml")
    assert "sweep file flock.yaml: " in refused(sweep.tool, "flock.yaml", "--reference")


def test_the_note_on_sections_that_are_not_read_is_short(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "flock.yaml"
    sections = (f"/node_{k}: {{ros__parameters: {{}}}}\n" for k in range(20_000))
    file.write_text("".join(sections) + "/**: {ros__parameters: {birds: 0}}")
    assert run_tool(reference.tool, ["--config", str(file)]) == 2
    note, error = capsys.readouterr().err.splitlines()
    assert "only the section /** is read" in note
    assert len(note) < 5000
    assert "birds = 0" in error


AXES = {
    "values": (f"axes:\n  span_ratio[2]: [{'1, ' * 500_000}]", "more than 500000 values"),
    "digits": (f"axes:\n  span_ratio[2]: [{'9' * 5000}]", "too many digits"),
    "date": ("axes:\n  span_ratio[2]: [2001-01-01]", "'2001-01-01' must be a number"),
    "axis": (r'axes: {"\e]0;x\a": [1]}', SHOWN),
    "section": (r'"\e]0;x\a": 1', f"unknown section '{SHOWN}'"),
    "count": ("axes:\n  span_ratio[2]: {from: 1, to: 2, count: 1e300}", "count 1e+300"),
}


@pytest.mark.parametrize("kind", AXES)
def test_a_hostile_sweep_file_is_refused(refused: Refused, tmp_path: Path, kind: str) -> None:
    text, said = AXES[kind]
    (tmp_path / "sweep.yaml").write_text(text)
    line = refused(sweep.tool, "sweep.yaml", "--reference")
    assert said in line
    assert "sweep file sweep.yaml: " in line


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/random", "pipe", ".", "x" * 300, "caf\udce9"])
def test_a_file_that_is_no_regular_file_is_refused(refused: Refused, path: str) -> None:
    os.mkfifo("pipe")  # no process writes to it: a read would wait for ever
    assert "configuration file " in refused(reference.tool, "--config", path)
    assert "sweep file " in refused(sweep.tool, path, "--reference")


def test_a_law_is_not_read_from_a_pipe(refused: Refused) -> None:
    os.mkfifo("pipe.py")
    assert "law file pipe.py: is a named pipe" in refused(
        reference.tool, "--forcing", "pipe.py:pull"
    )


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("caf\udce9", "output caf\\udce9: its name is not UTF-8 text"),
        ("x" * 250, "its name has 250 bytes; 230 are the limit"),
        ("x" * 300 + "/run", "File name too long"),
        ("/dev/full", "output /dev/full exists"),
    ],
)
def test_a_bag_is_not_written_where_its_files_cannot_be_named(
    refused: Refused, path: str, said: str
) -> None:
    assert said in refused(reference.tool, *SHORT, "--output", path)


@pytest.fixture
def own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A bag of Flock's."""
    bag = tmp_path / "own"
    text_of(reference.tool, capsys, *SHORT, "--output", str(bag))
    return bag


OUTPUTS: dict[str, tuple[Tool, tuple[str, ...]]] = {
    "picture": (picture.tool, ("own",)),
    "report": (report.tool, ("own",)),
    "limits": (limits.tool, ("--birds", "3", "--bird", "1")),
    "survey": (survey.tool, ("--birds", "3", "--samples", "2")),
    "arrange": (arrange.tool, ("--spans", "1,1.01")),
    "response": (response.tool, ("--birds", "3")),
}


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_device_or_a_pipe_is_no_output_file(refused: Refused, own: Path, name: str) -> None:
    tool, arguments = OUTPUTS[name]
    end = ".html" if name == "report" else ".png"
    os.mkfifo(f"pipe{end}")
    os.symlink("/dev/full", f"full{end}")
    for file in (f"pipe{end}", f"full{end}"):
        line = refused(tool, *arguments, "--output", file)
        assert f"--output {file}: is a device or a pipe; name a regular file" in line
    assert "File name too long" in refused(tool, *arguments, "--output", "x" * 300 + end)


def test_control_characters_in_the_name_of_a_bag_are_never_printed(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = own.rename(tmp_path / f"a{TITLE}b")
    second = tmp_path / "caf\udce9"
    shutil.copytree(bag, second)
    text_of(reference.tool, capsys, *SHORT, "--t-max", "10", "--output", str(tmp_path / "other"))
    for tool, status in (
        (metrics.tool, 0),
        (report.tool, 0),
        (picture.tool, 0),
        (repair.tool, 0),
        (lambda given: compare.tool([*given, str(tmp_path / "other")]), 1),
    ):
        for run, name in ((bag, SHOWN), (second, r"caf\udce9")):
            assert run_tool(tool, [str(run)]) == status
            told = capsys.readouterr()
            lines = (told.out + told.err).splitlines()
            assert all(map(str.isprintable, lines))
            assert tool is metrics.tool or name in told.out
    (bag / "metadata.yaml").unlink()
    assert run_tool(metrics.tool, [str(bag)]) == 0
    assert SHOWN in capsys.readouterr().err


def test_control_characters_in_the_name_of_a_law_are_never_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    law = tmp_path / f"{TITLE}.py"
    law.write_text("def pull(bird, neighbours, time):\n    return 0.0 * bird.speed\n")
    text_of(reference.tool, capsys, *SHORT, "--output", "plain")
    text_of(reference.tool, capsys, *SHORT, "--forcing", f"{law.name}:pull", "--output", "pulled")
    law.unlink()
    for tool, arguments, status in (
        (metrics.tool, ["pulled"], 0),
        (compare.tool, ["plain", "pulled"], 1),
        (picture.tool, ["pulled"], 0),
        (report.tool, ["pulled"], 0),
    ):
        assert run_tool(tool, arguments) == status
        told = capsys.readouterr()
        assert all(map(str.isprintable, (told.out + told.err).splitlines()))
        assert tool is not compare.tool or SHOWN in told.out


RECORDS = {
    "nested": ({"birds": "[" * 100_000}, "nested too deep; 64 levels are the limit"),
    "digits": ({"birds": "9" * 5000}, "no configuration that can be read"),
    "surrogate": ({"coupling": r'"\ud800"'}, r"'\ud800': known are nearest, all"),
    "control characters": ({TITLE: "1"}, f"unknown parameter '{SHOWN}'"),
    "control characters in a value": ({"coupling": r'"\u001b]0;x\u0007"'}, SHOWN),
    "list": ({"birds": "[1]"}, "birds = [1]: must be a number"),
}


@pytest.mark.parametrize("kind", RECORDS)
def test_a_hostile_configuration_in_a_bag_is_refused(
    refused: Refused, tmp_path: Path, kind: str
) -> None:
    record, said = RECORDS[kind]
    with (tmp_path / "run_0.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "somebody")
        writer.add_metadata(CONFIGURATION_RECORD, record)
        writer.finish()
    for tool in (metrics.tool, report.tool, picture.tool, repair.tool):
        assert said in refused(tool, "run_0.mcap")
