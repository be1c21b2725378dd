# SPDX-License-Identifier: Apache-2.0
"""Bad input gives one line with value, range and remedy, exit status 2, and no written files.

Most tools are called in this process, which is fast. A few are started as processes.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from mcap.writer import Writer

from flock_sim.commands import fly, reference
from flock_sim.console.arguments import run_tool
from flock_tools.commands import compare, metrics, picture, report
from support.terminal import Terminal, own_domain

Tool = Callable[[list[str]], int]
Say = Callable[[str, list[str]], str]

TOOLS = {
    "fly": fly.tool,
    "reference": reference.tool,
    "metrics": metrics.tool,
    "compare": compare.tool,
    "picture": picture.tool,
    "report": report.tool,
}

FLOCK = [
    (["--link", "hodl:delay=1"], ["unknown model 'hodl'", "did you mean 'hold'?"]),
    (["--link", "3->5=hold"], ["bird 5 does not feel bird 3", "4, 6"]),
    (["--link", "hold:drop=1"], ["drop=1", "[0, 1)"]),
    (["--link", "hold:delay=-1"], ["delay=-1", "0..10000"]),
    (["--link", "hold:delay=1/2", "--span-ratio", "4=1,1.1,1.2"], ["2 members", "have 3"]),
    (["--birds", "0"], ["birds = 0", "1 or more"]),
    (["--birds", "-3"], ["birds = -3", "1 or more"]),
    (["--birds", "2.5"], ["birds = 2.5", "whole number"]),
    (["--birds", "nan"], ["birds = nan", "whole number"]),
    (["--birds", "many"], ["birds = 'many'", "number"]),
    (["--span-ratio", "4=0"], ["'4=0'", "above 0"]),
    (["--span-ratio", "4=-1.05"], ["'4=-1.05'", "above 0"]),
    (["--span-ratio", "4=nan"], ["'4=nan'", "finite"]),
    (["--span-ratio", "4=inf"], ["'4=inf'", "finite"]),
    (["--span-ratio", "4=0.9,inf,1"], ["inf", "finite"]),
    (["--span-ratio", "4"], ["'4'", "I=LAMBDA"]),
    (["--span-ratio", "4=wide"], ["'4=wide'", "I=LAMBDA"]),
    (["--span-ratio", "4=1.0,"], ["'4=1.0,'", "I=LAMBDA"]),
    (["--span-ratio", "4=0.4", "--span-ratio", "5=0.5"], ["birds 4 and 5", "more than 1"]),
    (
        ["--span-ratio", "4=1,1.1", "--span-ratio", "5=1,1.1,1.2"],
        ["'4=1,1.1' has 2 members", "'5=1,1.1,1.2' has 3", "give 1 or 3"],
    ),
    (["--span-ratio", "14=1.05"], ["bird 14", "1..13"]),
    (["--span-ratio", "0=1.05"], ["bird 0", "1..13"]),
    (["--birds", "3", "--span-ratio", "4=1.05"], ["bird 4", "1..3"]),
    (["--span-ratio", "4=1.05", "--span-ratio", "4=1.1"], ["'4=1.1'", "twice", "'4=1.05'"]),
    (["--dt", "0"], ["dt = 0", "above 0"]),
    (["--dt", "-1"], ["dt = -1", "above 0"]),
    (["--dt", "nan"], ["dt = nan", "finite"]),
    (["--dt", "inf"], ["dt = inf", "finite"]),
    (["--dt", "fast"], ["dt = 'fast'", "number"]),
    (["--dt", "5e-324"], ["dt = ", "larger dt"]),
    (["--t-max", "0"], ["t_max = 0", "above 0"]),
    (["--t-max", "-5"], ["t_max = -5", "above 0"]),
    (["--t-max", "nan"], ["t_max = nan", "finite"]),
    (["--t-max", "inf"], ["t_max = inf", "finite"]),
    (["--t-max", "10", "--dt", "3"], ["t_max = 10", "multiple of dt = 3", "9 and 12"]),
    (["--t-max", "1", "--dt", "2"], ["t_max = 1", "multiple of dt = 2"]),
    (["--record-every", "0"], ["record_every = 0", "1 or more"]),
    (["--record-every", "1.5"], ["record_every = 1.5", "whole number"]),
    (["--coupling", "nearset"], ["'nearset'", "did you mean 'nearest'", "all"]),
    (["--brids", "3"], ["--brids", "--help"]),
    (["--bird", "3"], ["--bird", "--help"]),
    (["--birds"], ["--birds", "--help"]),
    (["stray"], ["stray", "--help"]),
]

OPERATION = [
    (["--processes", "0"], ["--processes 0", "1..13"]),
    (["--processes", "14"], ["--processes 14", "1..13"]),
    (["--birds", "2", "--processes", "3"], ["--processes 3", "1..2"]),
    (["--processes", "two"], ["--processes two", "1..13"]),
    (["--window", "0"], ["--window 0", "1 or more"]),
    (["--window", "2.5"], ["--window 2.5", "whole number"]),
    (["--executor", "event"], ["--executor event", "did you mean 'events'", "single"]),
    (["--timeout", "0"], ["--timeout 0", "above 0"]),
    (["--timeout", "nan"], ["--timeout nan", "finite"]),
    (["--no-record", "--record-stages"], ["--record-stages", "--no-record", "leave one out"]),
    (["--mode", "fre"], ["--mode fre", "did you mean 'free'", "lockstep"]),
    (["--mode", "free", "--real-time-factor", "0"], ["--real-time-factor 0", "above 0"]),
    (["--mode", "free", "--real-time-factor", "-2"], ["--real-time-factor -2", "above 0"]),
    (["--mode", "free", "--real-time-factor", "nan"], ["--real-time-factor nan", "finite"]),
    (["--mode", "free", "--real-time-factor", "0.001"], ["0.001", "a step would take 41.67 s"]),
    (["--mode", "free", "--window", "1"], ["--window", "--mode free", "leave one out"]),
    (["--mode", "free", "--record-stages"], ["--record-stages", "leave"]),
    (["--mode", "free", "--link", "hold:delay=3"], ["'hold:delay=3'", "free", "leave out"]),
    (["--real-time-factor", "2"], ["--real-time-factor", "--mode free"]),
    (["--network"], ["ROS_AUTOMATIC_DISCOVERY_RANGE = LOCALHOST", "--network", "leave one out"]),
]

FILES = [
    ("birds: 0", ["birds = 0", "1 or more"]),
    ("brids: 5", ["'brids'", "did you mean 'birds'"]),
    ("t_mx: 5.0", ["'t_mx'", "did you mean 't_max'"]),
    ("birds: true", ["birds = True", "number"]),
    ("birds: [3]", ["birds = [3]", "number"]),
    ("dt: .nan", ["dt = nan", "finite"]),
    ("coupling: 5", ["coupling = 5", "text"]),
    ("coupling: some", ["coupling = 'some'", "nearest, all"]),
    ('span_ratios: "4=1.05"', ["span_ratios = '4=1.05'", "list"]),
    ('span_ratios: ["4=0"]', ["'4=0'", "above 0"]),
    ('links: "hold"', ["links = 'hold'", "list such as"]),
    ('links: ["hold:jitter=-1"]', ["jitter=-1", "0..10000"]),
    ("cruise_speed: 17.0", ["cruise_speed = 17", "18"]),
    ("body_mass: 0", ["body_mass = 0", "above 0"]),
    ("wing_span: -1", ["wing_span = -1", "above 0"]),
    ("aspect_ratio: .inf", ["aspect_ratio = inf", "finite"]),
]


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    """A ROS domain that nobody else is on."""
    with own_domain() as domain:
        yield domain


@pytest.fixture
def say(
    tmp_path: Path,
    domain: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Say:
    """Run a tool on bad input and return the line it says."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(signal, "signal", lambda number, handler: None)  # pytest has its own

    def started(*arguments: object) -> None:
        raise AssertionError("a flight was started")

    monkeypatch.setattr(fly, "fly", started)
    monkeypatch.setattr(reference, "_integrate", started)

    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

    def run(tool: str, arguments: list[str]) -> str:
        before = everything(tmp_path)
        status = run_tool(TOOLS[tool], arguments)
        printed = capsys.readouterr()
        assert everything(tmp_path) == before
        assert printed.out == ""
        assert printed.err.startswith("error: ")
        assert printed.err.count("\n") == 1, printed.err
        assert status == 2
        return printed.err

    return run


def everything(directory: Path) -> dict[Path, bytes | None]:
    """All that is below a directory."""
    return {
        path: path.read_bytes() if path.is_file() else None
        for path in sorted(directory.rglob("*"))
    }  # fmt: skip


def words(case: object) -> str | None:
    return " ".join(case) if isinstance(case, list) else None


@pytest.mark.parametrize("tool", ["fly", "reference"])
@pytest.mark.parametrize(("arguments", "named"), FLOCK, ids=words)
def test_a_flock_that_cannot_be_flown_is_refused(
    say: Say, tool: str, arguments: list[str], named: list[str]
) -> None:
    line = say(tool, arguments)
    assert [word for word in named if word not in line] == [], line


@pytest.mark.parametrize(("arguments", "named"), OPERATION, ids=words)
def test_a_way_to_fly_that_there_is_not_is_refused(
    say: Say, arguments: list[str], named: list[str]
) -> None:
    line = say("fly", arguments)
    assert [word for word in named if word not in line] == [], line


@pytest.mark.parametrize("tool", ["fly", "reference"])
@pytest.mark.parametrize(("entry", "named"), FILES, ids=[entry for entry, _ in FILES])
def test_a_configuration_file_with_a_bad_value_is_refused_by_name(
    say: Say, tmp_path: Path, tool: str, entry: str, named: list[str]
) -> None:
    file = tmp_path / "flock.yaml"
    file.write_text(f"/**:\n  ros__parameters:\n    {entry}\n")
    line = say(tool, ["--config", str(file)])
    assert [word for word in [*named, str(file)] if word not in line] == [], line


BROKEN = {
    "not YAML": (b"/**: [1\n", "line"),
    "not text": (b"\xff\xfe\x00", "UTF-8"),
    "no node": (b"/flock/bird*:\n  ros__parameters: {}\n", "'/flock/bird*'"),
    "keys at the top": (b"birds: 3\n", "'birds'"),
    "a list": (b"- birds\n", "`/**:`"),
    "a list of parameters": (b"/**:\n  ros__parameters: [birds]\n", "ros__parameters"),
    "parameters missing": (b"/**:\n  birds: 3\n", "'birds'"),
    "a tab": (b"/**:\n\tros__parameters:\n", "line 2"),
}


@pytest.mark.parametrize("tool", ["fly", "reference"])
@pytest.mark.parametrize("broken", BROKEN)
def test_a_broken_configuration_file_is_refused(
    say: Say, tmp_path: Path, tool: str, broken: str
) -> None:
    content, named = BROKEN[broken]
    file = tmp_path / "flock.yaml"
    file.write_bytes(content)
    line = say(tool, ["--config", str(file)])
    assert str(file) in line
    assert named in line


@pytest.mark.parametrize("tool", ["fly", "reference"])
@pytest.mark.parametrize("path", ["missing.yaml", ".", "missing/flock.yaml"])
def test_a_configuration_file_that_is_not_there_is_refused(say: Say, tool: str, path: str) -> None:
    assert f"configuration file {path}: " in say(tool, ["--config", path])


@pytest.mark.parametrize("tool", ["fly", "reference"])
def test_an_output_that_exists_is_refused(say: Say, tmp_path: Path, tool: str) -> None:
    (tmp_path / "mine").mkdir()
    assert "--force" in say(tool, ["--output", "mine"])
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    assert "--force" in say(tool, ["--output", "mine"])
    assert "only a bag" in say(tool, ["--output", "mine", "--force"])
    (tmp_path / "file").write_text("")
    assert "--force" in say(tool, ["--output", "file"])
    assert "not a directory" in say(tool, ["--output", "file", "--force"])


@pytest.mark.parametrize("tool", ["fly", "reference"])
def test_an_output_that_is_not_writable_is_refused(say: Say, tmp_path: Path, tool: str) -> None:
    (tmp_path / "file").write_text("")
    assert "can't be written" in say(tool, ["--output", "file/below"])
    assert "can't be written" in say(tool, ["--output", "/proc/flock/run"])
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    if os.geteuid() != 0:  # root may write anywhere
        assert "can't be written" in say(tool, ["--output", "locked/run"])


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A bag of somebody else's."""
    bag = tmp_path / "foreign"
    bag.mkdir()
    with (bag / "foreign_0.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "somebody")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/chatter", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\2\0\0\0a\0", 1)
        writer.finish()
    (bag / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": {}}))
    return bag


@pytest.fixture
def own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A bag of Flock's."""
    bag = tmp_path / "own"
    arguments = ["--birds", "2", "--t-max", "20", "--output", str(bag)]
    assert run_tool(reference.tool, arguments) == 0
    capsys.readouterr()
    return bag


def ways(bag: Path, own: Path) -> list[tuple[str, list[str]]]:
    """Every tool that takes a run, with `bag` in every place."""
    return [
        ("metrics", [str(bag)]),
        ("metrics", [str(bag), "--json"]),
        ("picture", [str(bag)]),
        ("report", [str(bag)]),
        ("report", [str(own), str(bag), "--json"]),
        ("compare", [str(bag), str(own)]),
        ("compare", [str(own), str(bag), "--json"]),
    ]


def test_a_run_that_is_missing_empty_or_foreign_is_refused(
    own: Path, foreign: Path, tmp_path: Path, say: Say
) -> None:
    empty, text = tmp_path / "empty", tmp_path / "text"
    hollow, damaged = tmp_path / "hollow", tmp_path / "damaged"
    for made in (empty, text, hollow, damaged):
        made.mkdir()
    (text / "notes.txt").write_text("nothing to see")
    (hollow / "hollow_0.mcap").write_bytes(b"")
    (damaged / "damaged_0.mcap").write_bytes(b"not an MCAP file, for certain" * 9)
    missing, file = tmp_path / "missing", text / "notes.txt"
    for bag in (missing, empty, text, hollow, damaged, file, foreign):
        for tool, arguments in ways(bag, own):
            line = say(tool, arguments)
            assert str(bag) in line, line


def test_a_moment_or_a_tolerance_that_there_is_not_is_refused(own: Path, say: Say) -> None:
    assert "multiples of 10 up to 20" in say("metrics", [str(own), "--at", "15"])
    assert "multiples of 10 up to 20" in say("metrics", [str(own), "--at", "1e9"])
    for time in ("-10", "nan", "inf", "soon"):
        assert f"--at {time}: must be" in say("metrics", [str(own), f"--at={time}"])
    for tolerance in ("-1", "nan", "inf", "some"):
        line = say("compare", [str(own), str(own), f"--tolerance={tolerance}"])
        assert f"--tolerance {tolerance}: must be" in line
    assert "RUN" in say("metrics", [])
    assert "RUN" in say("compare", [str(own)])


@pytest.mark.parametrize(
    ("tool", "arguments"),
    [
        ("fly", ["--birds", "0"]),
        ("reference", ["--config", "missing.yaml"]),
        ("metrics", ["missing"]),
        ("compare", ["missing", "missing", "--json"]),
        ("picture", ["missing"]),
        ("bird", ["--ros-args", "-p", "birds:=3", "-p", "index:=4"]),
        ("clock", ["--ros-args", "-p", "window:=0"]),
        ("recorder", ["--ros-args", "-p", "birds:=3"]),
    ],
    ids=lambda case: case if isinstance(case, str) else None,
)
def test_the_whole_tool_says_one_line_and_exits_2(
    terminal: Terminal, tool: str, arguments: list[str]
) -> None:
    done = terminal.run(tool, *arguments)
    assert done.status == 2
    assert done.stderr == done.error + "\n"
    assert done.stdout == ""
    assert list(terminal.directory.iterdir()) == []
