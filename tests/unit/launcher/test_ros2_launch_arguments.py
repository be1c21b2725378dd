# SPDX-License-Identifier: Apache-2.0
"""The arguments of launches, and the installation of launch files for `ros2 launch`."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory

from flock_sim.errors import FlockError
from flock_sim.launcher.ros2_launch_arguments import ARGUMENTS, PROCESSES, Arguments, refuse_others

LAUNCH_FILES = ("flock.launch.py", "composed.launch.py")

DEFAULTS = {name: default for name, (default, _) in ARGUMENTS.items()}


@pytest.mark.parametrize("name", LAUNCH_FILES)
def test_launch_files_are_installed_and_are_python(name: str) -> None:
    file = Path(get_package_share_directory("flock_sim")) / "launch" / name
    code = compile(file.read_text(encoding="utf-8"), str(file), "exec")
    assert "generate_launch_description" in code.co_names


def test_every_launch_file_of_the_source_is_installed() -> None:
    source = Path(__file__).parents[3] / "src" / "flock_sim" / "launch"
    assert {file.name for file in source.iterdir()} == set(LAUNCH_FILES)


def test_without_arguments_thirteen_geese_are_flown_recorded_and_looked_after() -> None:
    told = Arguments.read(DEFAULTS)
    assert told.configuration.birds == 13
    assert (told.record, told.respawn) == (True, True)
    assert told.output.startswith("runs/launch-")
    assert told.partition() == [[bird] for bird in range(1, 14)]


@pytest.mark.parametrize(
    ("birds", "processes", "shares"),
    [
        (5, 1, [[1, 2, 3, 4, 5]]),
        (5, 2, [[1, 2], [3, 4, 5]]),
        (5, 5, [[1], [2], [3], [4], [5]]),
    ],
)
def test_neighbours_share_a_process(birds: int, processes: int, shares: list[list[int]]) -> None:
    told = Arguments.read({**DEFAULTS, "birds": str(birds), "processes": str(processes)})
    assert told.partition() == shares


def test_arguments_win_over_the_file_and_the_file_over_the_defaults(tmp_path: Path) -> None:
    file = tmp_path / "flock.yaml"
    file.write_text("/**: {ros__parameters: {birds: 7, t_max: 50, window: 1}}")
    told = Arguments.read({**DEFAULTS, "config": str(file)})
    assert (told.configuration.birds, told.configuration.t_max) == (7, 50.0)
    told = Arguments.read({**DEFAULTS, "config": str(file), "birds": "3", "record": "False"})
    assert (told.configuration.birds, told.configuration.t_max, told.record) == (3, 50.0, False)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"birds": "0"}, ["birds = 0", "1 or more"]),
        ({"birds": "many"}, ["birds", "many", "number"]),
        ({"config": "missing.yaml"}, ["missing.yaml", "No such file"]),
        ({"record": "maybe"}, ["record = maybe", "true or false"]),
        ({"respawn": ""}, ["respawn = ", "true or false"]),
        ({"birds": "3", "processes": "4"}, ["processes 4", "1..3"]),
        ({"namespace": "left wing"}, ["namespace = left wing", "letters, digits and _"]),
        ({"namespace": "/"}, ["namespace = /", "letters, digits and _"]),
    ],
    ids=str,
)
def test_a_wrong_argument_is_named_with_its_range(given: dict[str, str], named: list[str]) -> None:
    with pytest.raises(FlockError) as refused:
        Arguments.read({**DEFAULTS, **given})
    assert [word for word in named if word not in str(refused.value)] == [], refused.value
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("given", "pushed", "clock"),
    [
        ("", "", "/flock/clock"),
        ("left", "", "/left/clock"),
        ("left", "/fleet", "/fleet/left/clock"),
        ("/left", "/fleet", "/left/clock"),
        ("", "/fleet", "/fleet/clock"),
    ],
)
def test_sections_of_the_file_are_those_of_the_namespace(
    tmp_path: Path, given: str, pushed: str, clock: str
) -> None:
    """Only the clock of this namespace would fly another flock, which is refused by its name."""
    file = tmp_path / "flock.yaml"
    file.write_text(f"{clock}: {{ros__parameters: {{birds: 7}}}}")
    texts = {**DEFAULTS, "config": str(file), "namespace": given}
    with pytest.raises(FlockError, match=re.escape(clock.replace("clock", "recorder"))):
        Arguments.read(texts, pushed)


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("brids:=3", "did you mean 'birds'"),
        ("t_max:=100.0", "config:="),
        ("window:=1", "config:="),
        ("proceses:=2", "did you mean 'processes'"),
    ],
)
def test_an_argument_that_launch_would_pass_over_is_refused(word: str, hint: str) -> None:
    with pytest.raises(FlockError, match=hint):
        refuse_others([word], [*ARGUMENTS, *PROCESSES])


def test_processes_are_refused_where_every_bird_has_its_own() -> None:
    with pytest.raises(FlockError, match=r"composed\.launch\.py"):
        refuse_others(["processes:=2"], list(ARGUMENTS))


def test_arguments_of_other_launch_files_are_let_pass() -> None:
    words = ["rviz:=true", "map:=hall.yaml", "birds:=3", "launch-prefix:=nice"]
    refuse_others(words, [*ARGUMENTS, *PROCESSES])
