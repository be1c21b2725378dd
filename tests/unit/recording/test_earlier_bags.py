# SPDX-License-Identifier: Apache-2.0
"""Bags of versions whose states had no means are read, and the tools say what is not in them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.messages.state import MEANS, STATE_ENVELOPE, STATE_HEAD, STATE_NUMBERS_AT, VALUES
from flock_sim.messages.state_layout import Layout, layout_of, members_of, values_of
from flock_sim.messages.types import State
from flock_sim.recording.run import Run
from flock_tools.commands import compare, metrics, picture, report
from flock_tools.runs.dataset import load
from support.flights import record

FLOWN = FlockConfiguration(birds=3, t_max=40.0, record_every=10, span_ratios=("1=0.9,1.0",))


def early(data: bytes, members: int) -> bytes:
    """A state as versions without means encoded it."""
    array = STATE_NUMBERS_AT + 8 * members
    return data[: STATE_HEAD + len(VALUES) * array] + data[-STATE_ENVELOPE.size :]


@dataclass
class Early:
    """A state that is recorded without means."""

    state: State

    def encode(self) -> bytes:
        return early(self.state.encode(), len(self.state.position))


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same flight, recorded by a version without means and by this one."""
    path = tmp_path_factory.mktemp("bags")
    return record(path / "early", FLOWN, lambda _, state: Early(state)), record(path / "now", FLOWN)


@pytest.mark.parametrize("members", [1, 2, 3, 7])
def test_a_state_without_means_is_decoded(members: int) -> None:
    values = np.random.default_rng(members).normal(size=(6, members))
    whole = State.at(FlockConfiguration(), 20, *values, run_id=5, epoch=2).encode()
    data = early(whole, members)
    assert members_of(data) == members
    assert layout_of(data) == Layout(members, None, means=False)
    state = State.decode(data)
    for name, expected in zip(VALUES, values):
        assert np.array_equal(getattr(state, name), expected)
    assert [len(getattr(state, name)) for name in MEANS] == [0, 0]
    assert (state.step, state.run_id, state.epoch) == (20, 5, 2)
    mixed = values_of([data, whole], members)
    assert np.array_equal(mixed[:, :4], np.stack([values[:4]] * 2))
    assert np.isnan(mixed[0, 4:]).all()
    assert np.array_equal(mixed[1, 4:], values[4:])


@pytest.mark.parametrize("cut", [1, 8, 12, 20])
def test_a_state_that_is_cut_is_no_early_one(cut: int) -> None:
    data = State.at(FlockConfiguration(), 20, *np.ones((6, 2))).encode()
    for whole in (data, early(data, 2)):
        with pytest.raises(ValueError, match="too few"):
            State.decode(whole[:-cut])


def test_metrics_say_that_means_are_not_in_the_bag(
    bags: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    before, _ = bags
    assert run_tool(metrics.tool, [str(before)]) == 0
    words = "not in this bag, whose states have no means"
    assert capsys.readouterr().out.count(words) == 2
    assert run_tool(metrics.tool, [str(before), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["time_mean_speed"] == told["time_mean_drag_reduction"] == [None, None]


def test_it_is_the_same_flight_with_the_same_digest(
    bags: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    digests = [run.state_digest for run in map(Run, bags)]
    assert digests[0] == digests[1]
    assert run_tool(compare.tool, [*map(str, bags)]) == 0
    assert "equal bit for bit" in capsys.readouterr().out
    one, two = map(load, bags)
    for name in VALUES:
        assert np.array_equal(one[name], two[name])
    assert np.isnan(one.mean_speed).all()


@pytest.mark.parametrize("tool", [picture, report])
def test_it_is_drawn_and_reported(bags: tuple[Path, Path], tool: object, tmp_path: Path) -> None:
    output = tmp_path / ("page.html" if tool is report else "picture.png")
    assert run_tool(tool.tool, [str(bags[0]), "--output", str(output)]) == 0
    assert output.stat().st_size > 0
