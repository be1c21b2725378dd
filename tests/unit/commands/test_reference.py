# SPDX-License-Identifier: Apache-2.0
"""`reference` flies its configuration, and repeats a run bit for bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from flock_sim.commands.reference import tool
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation, perturbations
from flock_sim.launcher.reference_flight import row
from flock_sim.messages.types import Push
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.run import Run
from flock_sim.reference.integrator import Reference
from flock_tools.commands.repair import rewrite
from flock_tools.runs.comparison import Comparison, compare
from support.tool_runs import error_of, text_of

CONFIGURATION = FlockConfiguration(
    birds=4, t_max=60.0, record_every=7, span_ratios=("2=0.98,1.0",), perturbations=("3:2@20=0.1",)
)
LIVE = ("1@30=0.25,-0.01", "1:2@30=1e-3", "4:1@60=0.5", "2@0=0,0.01")


def pushes(entries: tuple[str, ...] = LIVE) -> tuple[Perturbation, ...]:
    return perturbations(entries, CONFIGURATION.birds, CONFIGURATION.members, CONFIGURATION.steps)


def flight(path: Path, *, rows: int = 1000) -> Path:
    """Record a flight as nodes would have, in which LIVE was asked for: the last of it first."""
    flown = list(Reference(CONFIGURATION, live=pushes()).fly())
    with recording(path, CONFIGURATION, grants=True) as run:
        for number, push in reversed(list(enumerate(pushes(), start=1))):
            run.write_perturbation(Push.of(99, number, push))
        for state in flown[:rows]:
            run.write_row(row(CONFIGURATION, state))
    return path


def states(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, time and bytes of every state."""
    with Run(path) as run:
        return [message for message in run.bag.messages() if message[0].endswith("/state")]


def compared(first: Path, second: Path) -> Comparison:
    with Run(first) as one, Run(second) as other:
        return compare(one, other)


def options(configuration: FlockConfiguration) -> list[str]:
    words = ["--birds", "4", "--t-max", "60", "--record-every", "7"]
    for option, entries in (
        ("--span-ratio", configuration.span_ratios),
        ("--perturb", configuration.perturbations),
    ):
        words += [word for entry in entries for word in (option, entry)]
    return words


def test_a_run_is_repeated_to_the_bit_with_what_was_asked_for_in_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = flight(tmp_path / "flown")
    text_of(tool, capsys, "--repeat", str(flown), "--output", str(tmp_path / "again"))
    assert states(tmp_path / "again") == states(flown)
    assert compared(flown, tmp_path / "again").equal
    # What was repeated can be repeated.
    with Run(tmp_path / "again") as again:
        assert again.missing is None
        assert again.configuration == CONFIGURATION
        assert again.perturbations() == list(pushes())


def test_a_push_is_the_same_in_flight_and_in_the_configuration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = flight(tmp_path / "flown")
    all_told = replace(CONFIGURATION, perturbations=CONFIGURATION.perturbations + LIVE)
    text_of(tool, capsys, *options(all_told), "--output", str(tmp_path / "told"))
    assert states(tmp_path / "told") == states(flown)


def test_a_flight_that_was_cut_short_is_repeated_to_its_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, cut = flight(tmp_path / "whole"), flight(tmp_path / "cut", rows=5)
    text_of(tool, capsys, "--repeat", str(cut), "--output", str(tmp_path / "again"))
    assert states(tmp_path / "again") == states(whole)


def test_what_was_asked_for_in_flight_survives_a_repair(tmp_path: Path) -> None:
    (tmp_path / "mended").mkdir()
    with Run(flight(tmp_path / "flown")) as flown:
        assert rewrite(flown, tmp_path / "mended") == 0
    with Run(tmp_path / "mended") as mended:
        assert mended.perturbations() == list(pushes())
    assert compared(tmp_path / "flown", tmp_path / "mended").equal


@pytest.mark.parametrize(
    "given",
    [
        ("--birds", "4"),
        ("--span-ratio", "1=1"),
        ("--perturb", "4@5=0.1"),
        ("--coupling", "all"),
        ("--dt", "1"),
        ("--t-max", "60"),
        ("--record-every", "7"),
        ("--config", "flock.yaml"),
    ],
    ids=lambda given: given[0],
)
def test_what_is_flown_is_not_told_twice(
    given: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "again"
    error = error_of(tool, capsys, "--repeat", "runs/any", *given, "--output", str(output))
    assert f"{given[0]} and --repeat exclude each other" in error
    assert "leave one out" in error
    assert not output.exists()


def test_a_run_that_is_not_there_is_not_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "again"
    error = error_of(tool, capsys, "--repeat", str(tmp_path / "no"), "--output", str(output))
    assert "there is no bag" in error
    assert not output.exists()


def fly(path: Path, capsys: pytest.CaptureFixture[str], *entries: str) -> Path:
    configuration = replace(CONFIGURATION, perturbations=entries)
    text_of(tool, capsys, *options(configuration), "--output", str(path))
    return path


def test_compare_tells_the_perturbed_from_the_unperturbed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calm, pushed = (
        fly(tmp_path / "calm", capsys),
        fly(tmp_path / "pushed", capsys, "3:2@28=0.1,-0.01"),
    )
    result = compared(calm, pushed)
    assert not result.equal
    assert [difference.field for difference in result.configuration] == ["perturbations"]
    assert result.configuration[0].values == ([], ["3:2@28=0.1,-0.01"])
    assert result.state is not None
    assert (result.state.step, result.state.bird, result.state.member) == (28, 2, 2)  # feels it
    # Also where nothing but the states tells of it.
    calm_one = replace(CONFIGURATION, perturbations=())
    with recording(tmp_path / "live", calm_one, grants=True) as run:
        for state in Reference(calm_one, live=pushes(("3:2@28=0.1",))).fly():
            run.write_row(row(calm_one, state))
    result = compared(calm, tmp_path / "live")
    assert not result.equal
    assert result.configuration == []


def test_pushes_that_mean_the_same_are_not_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = fly(tmp_path / "one", capsys, "3@20=0.1", "1@5=0,0.01")
    other = fly(tmp_path / "other", capsys, "1:2@5=0,1e-2", "1:1@5=0,0.01", "3@2e1=0.10,0")
    assert compared(one, other).equal
    # In another order they are other numbers.
    orders = ("3@20=0.1", "3@20=-5", "3@20=0.3"), ("3@20=0.3", "3@20=-5", "3@20=0.1")
    first, second = (fly(tmp_path / f"{k}", capsys, *order) for k, order in enumerate(orders))
    result = compared(first, second)
    assert [difference.field for difference in result.configuration] == ["perturbations"]
