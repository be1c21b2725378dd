# SPDX-License-Identifier: Apache-2.0
"""A flight with parts that are not in Flock: its bag says so, and no tool claims to repeat it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from flock_sim.commands import reference, resume
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import Parser, run_tool
from flock_sim.errors import FlockError
from flock_sim.forcing import registry as forcing_registry
from flock_sim.links import registry
from flock_sim.links.models import LinkModel
from flock_sim.links.registry import register
from flock_sim.links.source_digest import digest_of_source
from flock_sim.recording.flight_writer import lay_down, recording
from flock_sim.recording.own_parts import BIRD, LINK_MODEL, OwnPart, add_parts, own_laws
from flock_sim.recording.run import Run
from flock_tools.commands import compare, metrics, repair, report
from flock_tools.runs.dataset import load
from support.flights import flown_rows
from support.own_laws import with_law
from support.tool_runs import error_of, json_of, text_of

FLOCK = {"birds": 3, "t_max": 40.0, "record_every": 10}
KEEPER = OwnPart(BIRD, "Keeper")
FROZEN = OwnPart(LINK_MODEL, "frozen")


def frozen(age, position, speed, circulation, rate):
    return position, circulation


@pytest.fixture(autouse=True)
def only_here() -> Iterator[None]:
    yield
    del registry.MODELS[registry.BUILT_IN :]


def flight(path: Path, *parts: OwnPart, rows: int = 100, **flock: object) -> Path:
    """Record a flight in whose bag `parts` are named, with the states of a plain flock."""
    with recording(path, FlockConfiguration(**FLOCK, **flock), grants=True) as run:
        add_parts(run.bag, parts)
        for row in flown_rows(FlockConfiguration(**FLOCK))[:rows]:
            run.write_row(row)
    return path


def with_model(path: Path) -> Path:
    """Record a flight with a link model that is registered here, and leave it registered."""
    register(LinkModel("frozen", frozen))
    return flight(path, links=("frozen:interval=5",))


def forget_models() -> None:
    """Do as another process does, which has registered no model."""
    del registry.MODELS[registry.BUILT_IN :]


def page(run: Path, capsys: pytest.CaptureFixture[str]) -> str:
    output = run.with_suffix(".html")
    text_of(report.tool, capsys, str(run), "--output", str(output))
    return output.read_text(encoding="utf-8")


def test_a_bag_of_parts_of_flock_alone_names_none(tmp_path: Path) -> None:
    with Run(flight(tmp_path / "run", links=("hold:interval=5",))) as run:
        assert run.own_parts == []
        assert not [name for name in run.bag.records if name.startswith("own")]


def test_each_own_bird_and_link_model_is_in_the_bag_once(tmp_path: Path) -> None:
    register(LinkModel("frozen", frozen))
    other = OwnPart(BIRD, "Other")
    links = ("hold", "2->1=frozen:interval=5", "1->2=frozen")
    path = flight(tmp_path / "run", KEEPER, KEEPER, FROZEN, other, links=links)
    with Run(path) as run:
        assert run.own_parts == [FROZEN, KEEPER, other]
        records = [record for name, record in run.bag.records.items() if name.startswith("own")]
    assert [record["name"] for record in records] == ["frozen", "Keeper", "Other"]
    assert all("only its name" in record["note"] for record in records)


def test_a_flight_of_own_birds_is_not_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, again = flight(tmp_path / "run", KEEPER), tmp_path / "again"
    error = error_of(reference.tool, capsys, "--repeat", str(run), "--output", str(again))
    assert "flown by birds of Keeper, which are not in Flock" in error
    assert "flock_tools.fly(bird=...)" in error
    assert not again.exists()


def test_a_flight_of_own_birds_is_not_resumed_with_others(tmp_path: Path) -> None:
    run = flight(tmp_path / "run", KEEPER, rows=2)
    options = Parser("fly", "", "").parse_args([])
    vars(options).update(dict.fromkeys(resume.EXCLUDED))
    with (
        pytest.raises(FlockError, match="flown by birds of Keeper, which are not in Flock"),
        resume.resumable(run, options),
    ):
        pass


@pytest.mark.slow
def test_a_flight_with_a_registered_model_is_repeated_where_it_is_registered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    register(LinkModel("frozen", frozen))
    words = ["--birds", "3", "--t-max", "40", "--link", "frozen:interval=5", "--json"]
    run, again = tmp_path / "run", tmp_path / "again"
    assert run_tool(reference.tool, [*words, "--output", str(run)]) == 0
    told = capsys.readouterr()
    assert "note: flown with link model frozen: not a part of Flock" in told.err
    assert '"own_parts": ["link model frozen"]' in told.out
    assert run_tool(reference.tool, ["--repeat", str(run), "--output", str(again), "--json"]) == 0
    told = capsys.readouterr()
    assert f"note: the link model frozen of {run} is not in Flock" in told.err
    with Run(again) as repeated, Run(run) as flown:
        assert repeated.state_digest == flown.state_digest
        assert repeated.own_parts == [FROZEN]


@pytest.mark.slow
def test_where_it_is_not_registered_the_bag_is_read_and_its_flight_not_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, output = str(tmp_path / "run"), ["--output", str(tmp_path / "again")]
    register(LinkModel("frozen", frozen))
    flock = ["--birds", "3", "--t-max", "40", "--record-every", "10", "--link", "frozen:interval=5"]
    assert run_tool(reference.tool, [*flock, "--output", run]) == 0
    forget_models()
    capsys.readouterr()
    assert run_tool(metrics.tool, [run, "--json"]) == 0
    assert '"own_parts": ["link model frozen"]' in capsys.readouterr().out
    assert "equal bit for bit" in text_of(compare.tool, capsys, run, run)
    assert "link model frozen" in page(Path(run), capsys)
    error = error_of(reference.tool, capsys, "--repeat", run, *output)
    assert "link model 'frozen': only its name is known, from a bag: register it first" in error
    assert not (tmp_path / "again").exists()
    register(LinkModel("frozen", frozen))
    assert run_tool(reference.tool, ["--repeat", run, *output]) == 0
    with Run(tmp_path / "again") as repeated, Run(run) as flown:
        assert repeated.state_digest == flown.state_digest


def test_where_nothing_but_the_name_is_recorded_the_error_names_the_model_and_the_fix(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch
) -> None:
    monkeypatch.setattr("flock_sim.recording.flight_bag.own_records", lambda _: {})
    run = str(with_model(tmp_path / "run"))
    forget_models()
    error = error_of(metrics.tool, capsys, run)
    assert "its link model frozen is not in Flock" in error
    assert "register the model first" in error
    assert "not a bag" not in error


def test_a_bag_from_before_names_a_model_that_is_registered_here(
    tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr("flock_sim.recording.flight_bag.own_records", lambda _: {})
    with Run(with_model(tmp_path / "run")) as run:
        assert run.own_parts == [FROZEN]


def test_a_model_that_became_a_part_of_flock_is_still_that_of_the_user(
    tmp_path: Path, monkeypatch
) -> None:
    """The model of the same name in a later version may compute other values."""
    path = with_model(tmp_path / "run")
    monkeypatch.setattr("flock_sim.recording.own_parts.BUILT_IN", len(registry.MODELS))
    with Run(path) as run:
        assert run.own_parts == [FROZEN]


def test_the_bag_of_a_flight_that_has_only_begun_names_the_model(tmp_path: Path) -> None:
    register(LinkModel("frozen", frozen))
    flown = FlockConfiguration(links=("frozen:interval=5",), **FLOCK)
    lay_down(tmp_path / "run", flown, grants=True, stages=False)
    with Run(tmp_path / "run") as run:
        assert run.bag.records["own_link_model_1"]["name"] == "frozen"


def test_metrics_compare_and_the_dataset_name_the_own_parts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, plain = flight(tmp_path / "run", KEEPER), flight(tmp_path / "plain")
    line = f"note: {run} was flown with bird Keeper: not a part of Flock"
    for tool, arguments in ((metrics.tool, [str(run)]), (compare.tool, [str(run), str(plain)])):
        assert run_tool(tool, arguments) == 0
        assert line in capsys.readouterr().err
        assert run_tool(tool, [str(plain)] * len(arguments)) == 0
        assert capsys.readouterr().err == ""
    assert run_tool(metrics.tool, [str(run), "--json"]) == 0
    assert '"own_parts": ["bird Keeper"]' in capsys.readouterr().out
    assert json_of(metrics.tool, capsys, str(plain))["own_parts"] == []
    assert load(run).attrs["own_parts"] == "bird Keeper"
    assert "own_parts" not in load(plain).attrs


def test_a_repair_keeps_the_names(tmp_path: Path) -> None:
    (tmp_path / "repaired").mkdir()
    with Run(flight(tmp_path / "run", KEEPER, rows=2)) as run:
        repair.rewrite(run, tmp_path / "repaired")
    with Run(tmp_path / "repaired") as repaired:
        assert repaired.own_parts == [KEEPER]


def test_a_repair_keeps_the_digests_of_laws_that_are_not_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = "def law(bird): return 0.0\n"
    flown = with_law(tmp_path, source, "law", **FLOCK)
    with recording(tmp_path / "run", flown, grants=True) as bag:
        for row in flown_rows(FlockConfiguration(**FLOCK))[:2]:
            bag.write_row(row)
    (law,) = own_laws(flown)
    monkeypatch.setattr(forcing_registry, "_OWN", {})  # as in another process
    (tmp_path / "repaired").mkdir()
    with Run(tmp_path / "run") as run:
        repair.rewrite(run, tmp_path / "repaired")
    with Run(tmp_path / "repaired") as repaired:
        assert [part.digest for part in repaired.own_parts] == [law.digest]
        assert law.digest == digest_of_source(source.encode())


def test_a_repair_keeps_a_link_model_that_is_not_registered(tmp_path: Path) -> None:
    run_with_model = with_model(tmp_path / "run")
    forget_models()
    (tmp_path / "repaired").mkdir()
    with Run(run_with_model) as run:
        repair.rewrite(run, tmp_path / "repaired")
    forget_models()
    with Run(tmp_path / "repaired") as repaired:
        assert repaired.own_parts == [OwnPart(LINK_MODEL, "frozen")]


def test_the_report_of_own_birds_claims_no_repeat(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = page(flight(tmp_path / "run", KEEPER), capsys)
    assert "flown with bird Keeper: not a part of Flock" in text
    assert "not possible from the bag: birds of Keeper are not in Flock" in text
    assert "flies the same flock with birds of Flock" in text
    assert "--repeat" not in text
    assert "This run has birds of Keeper" in text


def test_the_report_of_an_own_link_model_says_where_it_can_be_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = page(with_model(tmp_path / "run"), capsys)
    assert "in a Python process that has registered the link model frozen: reference" in text
    assert "needs the link model frozen, which is not in Flock" in text
    assert "flies the same flock" not in text


def test_the_report_of_parts_of_flock_alone_says_how_to_repeat_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = flight(tmp_path / "run")
    text = page(run, capsys)
    assert f"<dt>repeat bit for bit</dt><dd>./flock reference --repeat {run} --output again" in text
    assert "<dt>own parts</dt><dd>none</dd>" in text
    assert "flies the same flock;" in text
