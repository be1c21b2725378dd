# SPDX-License-Identifier: Apache-2.0
"""`response` prints the specified JSON, describes the result in words, and refuses bad input."""

from pathlib import Path

import numpy as np
import pytest

from flock_tools.commands.response import tool
from support.tool_runs import error_of, json_of, text_of

Capture = pytest.CaptureFixture[str]

ALWAYS = {
    "exists": (3,),
    "stable": (3,),
    "speed_gain_peak": (3, 5),
    "speed_gain_frequency": (3, 5),
    "neighbour_gain_peak": (3, 4),
    "neighbour_gain_frequency": (3, 4),
    "hinf_gaps": (3,),
    "hinf_gaps_frequency": (3,),
    "hinf_gaps_from_leader": (3,),
    "hinf_gaps_from_leader_frequency": (3,),
}
IN_GUSTS = {
    "gap_std": (3, 4),
    "gap_std_gibbs": (3, 4),
    "gap_mean_gibbs": (3, 4),
    "bird_speed_std": (3, 5),
    "mean_speed_std": (3,),
    "speed_spread_rms": (3,),
}
BY_SPAN = {
    "speed_by_span": (3, 5),
    "spacing_by_span": (3, 4, 5),
    "share_by_span": (3, 4, 5),
    "margin_by_span": (3, 5),
}


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_the_json_is_the_contract(coupling: str, capsys: Capture) -> None:
    # Member 3: its leader is far too small.
    flock = ("--birds", "5", "--coupling", coupling, "--span-ratio", "3=1.0,1.05,0.55")
    found = json_of(tool, capsys, *flock, "--gust", "1e-5", "--sensitivity")
    shapes = {**ALWAYS, **IN_GUSTS, **BY_SPAN}
    assert {key: np.shape(found[key]) for key in shapes} == shapes
    assert found["exists"] == found["stable"] == [True, True, False]
    for key in shapes.keys() - {"exists", "stable"}:
        values = np.array(found[key], dtype=float)
        assert np.isnan(values[2]).all(), key
        unknown = coupling == "all" and key.endswith("gibbs")
        assert np.isfinite(values[:2]).all() != unknown, key
    assert (found["birds"], found["members"], found["coupling"]) == (5, 3, coupling)
    assert (found["lag"], found["link_model"], found["gust"]) == (0.0, None, 1e-5)
    assert found["seconds"] > 0.0
    for row in found["speed_gain_peak"][:2]:
        assert row[2] == 1.0
        assert min(row) >= 1.0


def test_without_the_options_their_keys_are_missing(capsys: Capture) -> None:
    found = json_of(tool, capsys, "--birds", "3")
    assert found.keys() >= ALWAYS.keys()
    assert not found.keys() & (IN_GUSTS.keys() | BY_SPAN.keys())


@pytest.mark.parametrize("model", ["linear", "hold"])
@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_late_links(coupling: str, model: str, capsys: Capture) -> None:
    flock = ("--birds", "4", "--coupling", coupling)
    late = ("--lag", "20", "--link-model", model, "--gust", "1e-6")
    found = json_of(tool, capsys, *flock, *late)
    assert (found["lag"], found["link_model"]) == (20.0, model)
    assert found["stable"] == [True]
    assert np.all(np.array(found["gap_std"]) > 0.0)
    assert found["gap_std_gibbs"] == [[None] * 3]
    exact = json_of(tool, capsys, *flock, "--gust", "1e-6")
    assert found["hinf_gaps"][0] > exact["hinf_gaps"][0]
    none = json_of(tool, capsys, *flock, "--lag", "0", "--link-model", model)
    assert none["hinf_gaps"] == exact["hinf_gaps"]


def test_the_text_tells_what_an_engineer_asks(capsys: Capture) -> None:
    text = text_of(tool, capsys, "--birds", "7", "--gust", "2e-5", "--sensitivity")
    assert "7 birds, nearest coupling, exact links" in text
    assert "string stability     no: bird 2 amplifies the speed changes of bird 3" in text
    assert "H-infinity of gaps" in text
    assert "worst gap          gap 1, standard deviation" in text
    for title in ("over leader", "over neighbour", "gap std", "Gibbs", "dU*/dlambda"):
        assert title in text
    assert max(len(line) for line in text.splitlines()) <= 110


def test_the_text_of_a_flock_that_absorbs_waves(capsys: Capture) -> None:
    text = text_of(tool, capsys, "--birds", "301")
    assert "string stability     yes: no bird amplifies" in text
    assert "no bird exceeds the changes of its speed" in text
    assert "--json lists all 301 birds" in text


def test_flocks_without_a_response(capsys: Capture) -> None:
    text = text_of(tool, capsys, "--birds", "5", "--span-ratio", "3=0.55,1.0", "--lag", "45")
    assert "no steady state: `./flock equilibrium` tells which birds part" in text
    assert "unstable: disturbances grow, no response" in text
    assert "0 of 2 members have a stable steady state" in text


def test_a_bird_alone(capsys: Capture) -> None:
    text = text_of(tool, capsys, "--birds", "1", "--gust", "1e-5")
    assert "1 bird, nearest coupling" in text
    assert "mean speed" in text
    assert "gap" not in text
    found = json_of(tool, capsys, "--birds", "1", "--gust", "1e-5")
    assert found["hinf_gaps"] == [0.0]
    assert found["gap_std"] == [[]]


@pytest.mark.slow
def test_a_picture_of_each_kind(tmp_path: Path, capsys: Capture) -> None:
    kinds = {
        "calm.svg": ("--birds", "5"),
        "gusts.png": ("--birds", "6", "--gust", "1e-5", "--span-ratio", "2=1.0,1.01"),
        "late.pdf": ("--birds", "3", "--coupling", "all", "--lag", "20", "--link-model", "hold"),
        "none.png": ("--birds", "5", "--span-ratio", "3=0.55"),
        "large.png": ("--birds", "101", "--gust", "1e-5"),
    }
    for name, flock in kinds.items():
        picture = tmp_path / name
        member = ("--member", "2") if name == "gusts.png" else ()
        text = text_of(tool, capsys, *flock, *member, "--output", str(picture))
        assert f"drawn: {picture}" in text
        assert picture.stat().st_size > 3000


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--lag", "-1"), "--lag -1: must be a number from 0"),
        (("--lag", "nan"), "--lag nan: must be a number from 0"),
        (("--lag", "soon"), "--lag soon: must be a number from 0"),
        (("--gust=-1e-5",), "--gust -1e-5: must be a number from 0"),
        (("--link-model", "line"), "--link-model 'line': did you mean 'linear'?"),
        (("--lag", "2", "--sensitivity"), "--sensitivity is for flocks without a lag"),
        (("--member", "2"), "--member 2: must be a whole number, 1..1"),
        (("--forcing", "gust:std=1"), "response solves the flight without forces"),
        (("--link", "hold"), "response solves the exact coupling"),
        (("--birds", "1", "--output", "x.png"), "needs a flock of 2 birds or more"),
        (("--output", "x.xyz"), "must end in one of"),
        (("--coupling", "all", "--birds", "300"), "must be 201 or less with --coupling all"),
        (("--birds", "0"), "birds = 0"),
    ],
)
def test_bad_input_is_refused(arguments: tuple[str, ...], expected: str, capsys: Capture) -> None:
    assert expected in error_of(tool, capsys, *arguments)
