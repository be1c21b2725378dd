# SPDX-License-Identifier: Apache-2.0
"""A process gets no more birds than it can start."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory

from flock_sim.commands.fly import tool
from flock_sim.configuration.choices import COUPLINGS
from flock_sim.errors import FlockError
from flock_sim.launcher.partition import (
    MOST_ENDPOINTS,
    MOST_PROCESSES,
    check_partition,
    most_endpoints,
    partition,
    process_count,
)
from flock_sim.launcher.ros2_launch_arguments import Arguments
from flock_sim.physics.formation import neighbours
from flock_sim.ros.discovery import PORTS
from flock_tools.commands import limits, sweep
from support.tool_runs import error_of


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize(("birds", "processes"), [(1, 1), (2, 1), (13, 2), (40, 3)])
def test_endpoints_are_those_of_the_largest_process(
    birds: int, processes: int, coupling: str
) -> None:
    counted = max(
        sum(3 + 2 * len(neighbours(bird, birds, coupling)) for bird in share)
        for share in partition(birds, processes)
    )
    # The birds at the ends of a line lack a neighbour each.
    ends = 0 if coupling == "all" or birds < 3 else 4
    assert counted <= most_endpoints(birds, coupling, processes) <= counted + ends


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("processes", [1, 2, 7])
def test_the_size_that_is_named_works_and_no_larger_one(coupling: str, processes: int) -> None:
    with pytest.raises(FlockError, match=coupling) as refused:
        check_partition(100_000, coupling, processes)
    found = re.search(r"fly (\d+) birds", str(refused.value))
    assert found
    works = int(found[1])
    check_partition(works, coupling, processes)
    assert most_endpoints(works + 1, coupling, processes) > MOST_ENDPOINTS


def test_fly_refuses_what_would_not_start_in_time() -> None:
    flock = ["--no-record", "--coupling", "all", "--birds", "150", "--t-max", "10"]
    with pytest.raises(FlockError, match=r"150 birds .* in one process: .* fly 70 birds"):
        tool(flock)


def test_as_many_processes_as_are_named_work_and_no_more() -> None:
    for coupling in COUPLINGS:
        most = process_count("--processes", str(MOST_PROCESSES), 500, coupling)
        assert most == MOST_PROCESSES
        with pytest.raises(FlockError, match=rf"--processes {most + 1}: .*; give {most} or fewer"):
            process_count("--processes", str(most + 1), 500, coupling)


@pytest.mark.parametrize("settings", ["machine.xml", "network.xml"])
def test_all_processes_of_a_flight_are_looked_for(settings: str) -> None:
    share = Path(get_package_share_directory("flock_sim"))
    told = (share / settings).read_text(encoding="utf-8")
    found = re.search(r"<maxInitialPeersRange>(\d+)<", told)
    assert found
    looked_for = int(found[1])
    assert looked_for >= MOST_PROCESSES + 2  # clock and recorder
    # The last of them has two ports, which are not yet those of the next domain.
    assert 10 + 2 * looked_for + 1 < PORTS


def test_fly_refuses_more_processes_than_find_each_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "bag"
    words = ["--birds", "70", "--processes", "61", "--output", str(output)]
    assert "give 60 or fewer" in error_of(tool, capsys, *words)
    assert not output.exists()


def test_a_sweep_refuses_them_before_it_begins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, output = tmp_path / "sweep.yaml", tmp_path / "swept"
    file.write_text('flock: {birds: 70, t_max: 10}\naxes: {"span_ratio[1]": [0.95, 1.0]}\n')
    words = [str(file), "--processes", "61", "--output", str(output)]
    assert "give 60 or fewer" in error_of(sweep.tool, capsys, *words)
    assert not output.exists()


def test_limits_that_are_flown_refuse_them(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--method", "fly", "--birds", "70", "--processes", "61"]
    assert "give 60 or fewer" in error_of(limits.tool, capsys, *words)


def test_a_launch_of_a_process_a_bird_names_the_other_one() -> None:
    given = {"config": "", "output": "", "namespace": "", "record": "true", "respawn": "true"}
    with pytest.raises(FlockError, match=r"birds 61: .* composed\.launch\.py with processes:=60"):
        Arguments.read({**given, "birds": "61"})
    assert Arguments.read({**given, "birds": "61", "processes": "60"}).processes == 60
    with pytest.raises(FlockError, match=r"processes 61: .*give 60 or fewer"):
        Arguments.read({**given, "birds": "61", "processes": "61"})
