# SPDX-License-Identifier: Apache-2.0
"""The members of a sweep are the flocks of its file, and fly as they would alone."""

from __future__ import annotations

import itertools
import re
import sys
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import xarray as xr
import yaml
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import in_order
from flock_sim.errors import FlockError
from flock_sim.launcher.reference_flight import row
from flock_sim.links.keys import FAULTS
from flock_sim.links.registry import MODELS
from flock_sim.recording.flight_writer import recording
from flock_sim.reference.integrator import Reference
from flock_tools.commands.sweep import tool
from flock_tools.experiments.sweep import runner
from flock_tools.experiments.sweep.axes import axis
from flock_tools.experiments.sweep.dataset import ATTRIBUTES, dataset, netcdf, recorded
from flock_tools.experiments.sweep.directory import SweepDirectory
from flock_tools.experiments.sweep.members import MOST_RECORDS, record_every
from flock_tools.experiments.sweep.runner import fly_all
from flock_tools.experiments.sweep.specification import Sweep, sweep
from flock_tools.figures.sweep import draw_sweep
from support.flights import record
from support.tool_runs import error_of

AXES: dict[str, list[Any]] = {
    "span_ratio[2]": [0.95, 1.0, 1.1],
    "lambda_3": [1.02, 0.98],
    "position[1]": [0.0, -0.25],
    "speed[3]": [0.01, 0.0],
    "link.delay": [0, 3, 1],
    "link[2->3].drop": [0.0, 0.4],
    "link[1->2].model": ["hold", "linear"],
    "link.interval": [1, 3],
    "link.seed": [1, 2, 3],
    "link.noise": [0.0, 0.01],
    "coupling": ["nearest", "all"],
    "dt": [1.0, 0.5],
}


def asked(axes: dict[str, Any], **flock: Any) -> Sweep:
    return sweep({"flock": {"birds": 4, "t_max": 20, **flock}, "axes": axes})


@given(
    st.lists(st.sampled_from(sorted(AXES)), min_size=1, max_size=4, unique=True),
    st.integers(1, 40),
    st.sampled_from([["hold:timeout=9"], ["linear", "3->4=hold:jitter=2"]]),
)
def test_flights_hold_every_member_once_and_as_it_would_fly_alone(
    names: list[str], at_once: int, links: list[str]
) -> None:
    swept = asked(
        {name: AXES[name] for name in names},
        links=links,
        span_ratios=["4=1.01"],
        perturbations=["2@7=0.1,-0.01", "1@0=0.2"],
    )
    alone = [member.configuration() for member in swept.members()]
    flights = swept.flights(at_once)
    assert sorted(m for flight in flights for m in flight.members) == list(range(swept.size))
    for flight in flights:
        joint = flight.configuration
        assert joint.members == len(flight.members) <= at_once
        for column, m in enumerate(flight.members):
            single = alone[m]
            for key in ("birds", "coupling", "dt", "t_max", "record_every"):
                assert getattr(joint, key) == getattr(single, key)
            assert np.array_equal(joint.span_ratio[:, column], single.span_ratio[:, 0])
            pushed = [push for push in in_order(joint.pushes) if push.member == column + 1]
            assert [(p.step, p.bird, p.position, p.speed) for p in pushed] == [
                (p.step, p.bird, p.position, p.speed) for p in in_order(single.pushes)
            ]
            for source, target in itertools.permutations(range(1, 5), 2):
                one, other = (
                    joint.link_table.of(source, target),
                    single.link_table.of(source, target),
                )
                assert (one.model, one.interval) == (other.model, other.interval)
                faults = np.broadcast_to(one.faults, (len(FAULTS), joint.members))
                assert np.array_equal(faults[:, column], other.faults[:, 0])


def test_members_are_the_product_of_the_axes_the_last_one_fastest() -> None:
    swept = asked(
        {
            "span_ratio[2]": {"from": 0.9, "to": 1.1, "count": 3},
            "link.delay": [0, 5],
            "link[3->4].drop": [0.25],
        },
        links=["hold:interval=2"],
    )
    assert swept.shape == (3, 2, 1)
    members = [member.configuration() for member in swept.members()]
    assert [float(member.span_ratio[1, 0]) for member in members] == [0.9, 0.9, 1, 1, 1.1, 1.1]
    assert [member.link_table.of(1, 2).faults[0, 0] for member in members] == [0, 5, 0, 5, 0, 5]
    assert members[1].links == (
        "hold:interval=2,delay=5",
        "3->4=hold:interval=2,delay=5,drop=0.25",
    ) or members[1].links == ("hold:interval=2,delay=5", "3->4=hold:interval=2,drop=0.25,delay=5")


def test_evenly_spaced_values_are_sums_of_a_start_and_whole_steps() -> None:
    # They are flown, so they must have the same bits on every machine.
    random = np.random.default_rng(18)
    for count in (2, 3, 10, 57, 1000):
        low, high = random.uniform(0.5, 1.5, 2).tolist()
        found = axis("dt", {"from": low, "to": high, "count": count})
        step = (high - low) / (count - 1)
        assert found.values == (*(low + k * step for k in range(count - 1)), high)


def settings_of(swept: Sweep, source: int, target: int) -> list[tuple[str, int, float]]:
    """The model, the interval and the delay of a link in all members, as flown in one go."""
    found = {}
    for flight in swept.flights(100):
        link_table = flight.configuration.link_table
        for column, member in enumerate(flight.members):
            link = link_table.of(source, target)
            delays = np.broadcast_to(link.faults[0], len(flight.members))
            found[member] = MODELS[link.model].name, link.interval, float(delays[column])
    return [found[member] for member in range(swept.size)]


@pytest.mark.parametrize("spelled", ["2->3", "02->3", "2 -> 3", " 2->03 ", "+2->3", "2->3 "])
@pytest.mark.parametrize("axis", ["link[2->3].delay", "link[02->3].delay", "link.delay"])
def test_a_single_link_of_the_flock_stays_as_it_is_set_but_for_the_axis(
    spelled: str, axis: str
) -> None:
    swept = asked({axis: [0, 5]}, links=[f"{spelled}=hold:interval=5"])
    assert settings_of(swept, 2, 3) == [("hold", 5, 0.0), ("hold", 5, 5.0)]
    others = 5.0 if axis == "link.delay" else 0.0
    assert settings_of(swept, 3, 2) == [("exact", 1, 0.0), ("exact", 1, others)]


LINK_ENTRIES = st.tuples(
    st.sampled_from([None, (1, 2), (2, 1), (2, 3), (4, 3)]),
    st.sampled_from(["{}->{}", "0{}->{}", "{} -> {}"]),
    st.sampled_from(["hold:interval=5", "linear", "linear:interval=2,drop=0.5", "hold:delay=3"]),
)


@given(
    st.lists(LINK_ENTRIES, max_size=5),
    st.sampled_from([None, (1, 2), (2, 3), (3, 4)]),
    st.sampled_from(["delay", "seed"]),
)
def test_an_axis_of_links_changes_its_key_and_nothing_else(
    entries: list[tuple[tuple[int, int] | None, str, str]], one: tuple[int, int] | None, key: str
) -> None:
    links = [f"{form.format(*link)}={what}" if link else what for link, form, what in entries]
    axis = f"link[{one[0]}->{one[1]}].{key}" if one else f"link.{key}"
    base = FlockConfiguration(birds=4, t_max=20, links=tuple(links)).link_table
    row = list(FAULTS).index(key)
    swept = asked({axis: [2, 9]}, links=links)
    for value, member in zip((2, 9), swept.members(), strict=True):
        flown = member.configuration().link_table
        for link in itertools.permutations(range(1, 5), 2):
            if abs(link[0] - link[1]) > 1:
                continue
            before, after = base.of(*link), flown.of(*link)
            expected = before.faults.copy()
            if one in (None, link):
                expected[row] = value
            assert np.array_equal(after.faults, expected), link
            assert (after.model, after.interval) == (before.model, before.interval), link


def test_what_is_said_of_one_link_wins_over_what_is_said_of_all_in_any_order() -> None:
    axes = {"link[1->2].delay": [7], "link.delay": [2]}
    for names in (list(axes), list(axes)[::-1]):
        (member,) = asked({name: axes[name] for name in names}).members()
        link_table = member.configuration().link_table
        assert link_table.of(1, 2).faults[0, 0] == 7
        assert link_table.of(2, 1).faults[0, 0] == 2


def test_a_link_may_be_written_with_a_colon() -> None:
    arrow, colon = (
        asked({f"link[2{sign}3].delay": [1, 2]}, links=[f"2{sign}3=hold"]) for sign in ("->", ":")
    )
    assert colon.text() == arrow.text()
    assert colon.members() == arrow.members()
    with pytest.raises(FlockError, match="the same as"):
        asked({"link[2->3].delay": [1], "link[2:3].delay": [1]})


def test_the_text_of_a_sweep_is_that_sweep() -> None:
    axes = {name: AXES[name] for name in AXES if name not in ("lambda_3", "dt", "link.seed")}
    axes["link.interval"] = [2]
    swept = asked(axes, links=["hold"], span_ratios=["1=1.01"])
    again = sweep(yaml.safe_load(swept.text()))
    assert again.text() == swept.text()
    assert again.members() == swept.members()


@given(st.integers(1, 10**7))
def test_the_end_is_recorded_and_not_many_steps_before_it(steps: int) -> None:
    every = record_every(steps)
    assert steps % every == 0
    assert 1 <= steps // every <= MOST_RECORDS


@pytest.mark.parametrize(
    ("steps", "every"),
    [(1, 1), (7, 1), (20, 1), (100000, 5000), (23, 23), (46, 23), (10007, 10007)],
)
def test_the_last_step_is_among_few_that_are_recorded(steps: int, every: int) -> None:
    assert record_every(steps, 20) == every


def test_a_sweep_records_enough_steps_for_a_verdict() -> None:
    assert record_every(100000) == 500


@pytest.mark.parametrize(
    ("axes", "flock", "words"),
    [
        ({}, {}, ["`axes:` must hold one or more"]),
        ({"span_ratoi[2]": [1]}, {}, ["'span_ratoi[2]'", "did you mean 'span_ratio[I]'"]),
        ({"link.loss": [1]}, {}, ["unknown key 'loss'", "did you mean 'drop'"]),
        ({"link.dely": [1]}, {}, ["unknown key 'dely'", "did you mean 'delay'"]),
        ({"link.delay": []}, {}, ["'link.delay'", "has no values"]),
        ({"link.delay": 5}, {}, ["'link.delay'", "must be a list"]),
        ({"link.delay": ["late"]}, {}, ["'late'", "must be a number"]),
        ({"link.delay": [-1]}, {}, ["delay=-1", "0..10000", "at link.delay = -1"]),
        ({"link.drop": [0.5, 1]}, {}, ["drop=1", "[0, 1)", "at link.drop = 1"]),
        ({"link.model": ["hodl"]}, {}, ["unknown model 'hodl'", "did you mean 'hold'"]),
        ({"link.model": [1]}, {}, ["value 1 must be text"]),
        ({"link[1->3].delay": [1]}, {}, ["bird 3 does not feel bird 1"]),
        ({"link[4->5].delay": [1]}, {}, ["bird 5 is not among 1..4"]),
        ({"span_ratio[5]": [1]}, {}, ["bird 5 is not among 1..4"]),
        ({"span_ratio[2]": [0]}, {}, ["above 0"]),
        ({"span_ratio[2]": [1, 1.0]}, {}, ["1 is given twice"]),
        ({"span_ratio[2]": [1], "lambda_2": [1]}, {}, ["'lambda_2'", "the same as"]),
        ({"position[9]": [1]}, {}, ["bird 9 is not among 1..4"]),
        ({"speed[1]": [float("nan")]}, {}, ["finite"]),
        ({"birds": [3, 4]}, {}, ["'birds'", "below `flock:`"]),
        ({"dt": [0.0]}, {}, ["dt = 0", "above 0"]),
        ({"dt": [3.0]}, {}, ["t_max = 20", "multiple of dt = 3"]),
        ({"dt": {"from": 1, "to": 2}}, {}, ["'count' is missing"]),
        ({"dt": {"from": 1, "to": 2, "cuont": 2}}, {}, ["'cuont'", "did you mean 'count'"]),
        ({"dt": {"from": 1, "to": 2, "count": 0}}, {}, ["count 0", "1..100000"]),
        ({"t_max": {"from": 100, "to": 1000, "count": 1}}, {}, ["count 1", "100 and 1000"]),
        ({"dt": [1.0]}, {"bird": 3}, ["unknown parameter 'bird'", "did you mean 'birds'"]),
        ({"dt": [1.0]}, {"span_ratios": ["2=1,1.1"]}, ["2 members", "one value of each"]),
        ({"dt": [1.0]}, {"links": ["hold:delay=1/2/3"]}, ["3 members", "one value of each"]),
        (
            {"dt": [1.0]},
            {"span_ratios": ["2=1,1.1"], "links": ["hold:delay=1/2/3"]},
            ["3 members and span_ratios have 2"],
        ),
        ({"dt": [1.0]}, {"record_every": 7}, ["record_every = 7", "must divide the 20 steps"]),
        (
            {f"link.{key}": {"from": 0, "to": 0.9, "count": 1000} for key in ("drop", "noise")},
            {},
            ["1000 x 1000 values are 1000000 members", "100000 or less"],
        ),
    ],
)
def test_bad_input_is_one_line(
    axes: dict[str, Any],
    flock: dict[str, Any],
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(yaml.safe_dump({"flock": {"birds": 4, "t_max": 20, **flock}, "axes": axes}))
    error = error_of(tool, capsys, str(file), "--output", str(tmp_path / "out"))
    for word in words:
        assert word in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ["No such file"]),
        ("axes: [", ["not YAML at line 2"]),
        ("axes:\n  dt: [1]\n  dt: [2]\n", ["'dt' is given twice"]),
        ("- dt", ["must have a section `axes:`"]),
        ("axis: {dt: [1]}", ["unknown section 'axis'", "did you mean 'axes'"]),
        ("flock: 3\naxes: {dt: [1]}", ["`flock:` must hold"]),
    ],
)
def test_a_file_that_is_no_sweep_is_refused(
    content: str | None, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "s.yaml"
    if content is not None:
        file.write_text(content)
    error = error_of(tool, capsys, str(file), "--output", str(tmp_path / "out"))
    for word in [str(file), *words]:
        assert word in error
    assert not (tmp_path / "out").exists()


def test_what_is_no_sweep_of_ours_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    for force, words in ((False, "holds no sweep"), (True, "is not a sweep")):
        with (
            pytest.raises(FlockError, match=words),
            SweepDirectory(tmp_path).held("plan", force),
        ):
            pass
    assert (tmp_path / "letter.txt").read_text() == "dear"


def test_a_directory_that_a_kill_has_left_without_a_plan_is_taken(tmp_path: Path) -> None:
    (tmp_path / "sweep.yaml.part").write_text("half a pl")
    with SweepDirectory(tmp_path).held("plan", False):
        pass
    assert [entry.name for entry in tmp_path.iterdir()] == ["sweep.yaml"]


def test_another_sweep_is_refused_and_replaced_if_asked_for(tmp_path: Path) -> None:
    output = tmp_path / "deep" / "out"
    for plan, force in (("one", False), ("one", False), ("two", True)):
        with SweepDirectory(output).held(plan, force):
            assert not force or not (output / "sweep.nc").exists()
            (output / "sweep.nc").touch()
            if force:
                record(output / "flight_01", FlockConfiguration(birds=1, t_max=10.0))
        assert (output / "sweep.yaml").read_text() == plan
    with (
        pytest.raises(FlockError, match="holds another sweep"),
        SweepDirectory(output).held("one", False),
    ):
        pass


def test_a_flight_is_complete_once_every_state_of_it_is_there_and_sound(tmp_path: Path) -> None:
    (flight,) = asked({"speed[2]": [0.0, 0.01]}).flights(5)
    directory = SweepDirectory(tmp_path)
    bag = directory.bag(flight)
    assert not (directory.begun(flight))
    assert not (directory.complete(flight))
    with recording(bag, flight.configuration, grants=True):
        pass  # interrupted before the first row
    assert directory.begun(flight)
    assert not directory.complete(flight)
    with recording(bag, flight.configuration, grants=True, resume=True) as run:
        for recorded in Reference(flight.configuration).fly():
            run.write_row(row(flight.configuration, recorded))
            run.flush()
    assert directory.complete(flight)
    data = bytearray(run.bag.path.read_bytes())
    data[data.index(b"\x04\x00\x00\x00zstd") + 40] ^= 1
    run.bag.path.write_bytes(data)
    assert directory.begun(flight)
    assert not directory.complete(flight)


def flown(swept: Sweep, directory: Path) -> xr.Dataset:
    """The dataset of a sweep that `reference` has flown, flight by flight."""
    flights = swept.flights(5)
    bags = [SweepDirectory(directory).bag(flight) for flight in flights]
    for flight, bag in zip(flights, bags, strict=True):
        record(bag, flight.configuration)
    return dataset(swept, recorded(swept, flights, bags), "./flock sweep s.yaml")


def test_a_member_that_diverges_is_told_and_spoils_no_other(tmp_path: Path) -> None:
    # The second is thrown so hard that its drag is beyond all numbers.
    found = flown(asked({"speed[2]": [0.0, 1e200, 0.01]}), tmp_path)
    assert found.diverged.values.tolist() == [0, 1, 0]
    assert found.holds.values[1] == 0
    calm = flown(asked({"speed[2]": [0.0, 0.01]}), tmp_path / "calm")
    assert np.array_equal(found.position[::2], calm.position)


@pytest.mark.parametrize(
    "axes",
    [
        ["span_ratio[2]"],
        ["link.delay", "coupling"],
        ["link[1->2].model", "link.seed", "link.delay", "dt"],
    ],
    ids=len,
)
def test_a_dataset_survives_netcdf_with_names_and_units_and_can_be_drawn(
    axes: list[str], tmp_path: Path
) -> None:
    swept = asked({name: AXES[name] for name in axes})
    found = flown(swept, tmp_path)
    (tmp_path / "sweep.nc").write_bytes(netcdf(found))
    assert (tmp_path / "sweep.nc").read_bytes()[:4] == b"CDF\2"
    with xr.open_dataset(tmp_path / "sweep.nc", engine="scipy") as again:
        assert again.identical(found)
        for name, variable in again.variables.items():
            assert variable.attrs["units"], name
            assert variable.attrs["long_name"], name
        assert again.attrs.keys() >= {"configuration", "command", "versions"}
        assert sweep(yaml.safe_load(again.attrs["configuration"])).text() == swept.text()
    assert set(found.data_vars) <= set(ATTRIBUTES)
    figure = draw_sweep(found, swept)
    figure.savefig(tmp_path / "sweep.png")
    assert len(figure.axes) >= 2


def test_curves_and_maps_are_drawn_over_ascending_values(tmp_path: Path) -> None:
    given = {"span_ratio[2]": [1.0, 0.9, 1.1, 0.8]}
    swept = asked(given)
    found = flown(swept, tmp_path / "one")
    curve = draw_sweep(found, swept).axes[1].lines[0]
    assert curve.get_xdata().tolist() == [0.8, 0.9, 1.0, 1.1]
    assert curve.get_ydata().tolist() == found.mean_spacing.values[[3, 1, 0, 2]].tolist()
    swept = asked({"position[1]": [0.0, -0.25], **given})
    found = flown(swept, tmp_path / "two")
    cells = draw_sweep(found, swept).axes[1]
    assert [label.get_text() for label in cells.get_xticklabels()] == ["0.8", "0.9", "1", "1.1"]
    assert [label.get_text() for label in cells.get_yticklabels()] == ["-0.25", "0"]
    shown = found.mean_spacing.values[::-1][:, [3, 1, 0, 2]]
    assert cells.collections[0].get_array().tolist() == shown.tolist()


def test_what_is_flown_is_not_flown_again_and_what_is_another_flight_is_refused(
    tmp_path: Path,
) -> None:
    swept, directory = asked({"span_ratio[2]": [0.95, 1.0]}), SweepDirectory(tmp_path)
    flown(swept, tmp_path)
    assert fly_all(swept.flights(5), directory, ["--no-such-option"]) == 0
    with pytest.raises(FlockError, match="is not the bag of flight 1 of this sweep"):
        fly_all(asked({"span_ratio[2]": [0.95, 1.01]}).flights(5), directory, [])


@pytest.mark.parametrize("terminal", [False, True])
def test_the_time_left_is_told_on_a_terminal_once_a_flight_was_flown(
    terminal: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(runner, "_fly", lambda arguments, lock: 0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    flights = asked({"span_ratio[2]": [0.95, 1.0, 1.1]}).flights(1)
    assert fly_all(flights, SweepDirectory(tmp_path), []) == 3
    told = [
        bool(re.search(r", about \d+:\d\d:\d\d left$", line))
        for line in capsys.readouterr().err.splitlines()
    ]
    assert told == [False, terminal, terminal]


def test_members_of_the_dataset_are_those_that_fly_alone(tmp_path: Path) -> None:
    random = Random(7)
    swept = asked(
        {name: AXES[name] for name in ("dt", "link[1->2].model", "span_ratio[2]")},
        links=["hold:drop=0.3,delay=1"],
        perturbations=["3@4=0.1"],
    )
    found = flown(swept, tmp_path)
    members = swept.members()
    for m in random.sample(range(swept.size), 4):
        alone = Reference(members[m].configuration())
        alone.advance(alone.configuration.steps)
        at = np.unravel_index(m, swept.shape)
        assert np.array_equal(found.position.values[at], alone.position[:, 0])
        assert np.array_equal(found.speed.values[at], alone.speed[:, 0])


def test_a_flock_of_the_file_may_be_left_out() -> None:
    assert sweep({"axes": {"dt": [1.0]}}).flock == FlockConfiguration()
