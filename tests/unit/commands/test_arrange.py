# SPDX-License-Identifier: Apache-2.0
"""`arrange` prints the best orders of birds as JSON, as text and as a picture."""

from pathlib import Path

import numpy as np
import pytest

from flock_sim.theory.arrangement import arrange as arrange_module
from flock_tools.commands.arrange import MOST_BIRDS, tool
from support.steady_states import steady
from support.tool_runs import error_of, json_of, text_of

BIRDS = "1.04,0.96,1,0.98,1.02"


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_the_json_is_the_contract(coupling: str, capsys: pytest.CaptureFixture[str]) -> None:
    result = json_of(tool, capsys, "--spans", BIRDS, "--coupling", coupling)
    assert (result["birds"], result["coupling"], result["method"]) == (5, coupling, "exact")
    assert result["spans"] == [0.96, 0.98, 1.0, 1.02, 1.04]
    assert result["orders"] == 60 > result["flying"] > 0
    fastest, flying, firmest = (result[key] for key in ("fastest", "fastest_flying", "firmest"))
    assert fastest["speed"] > flying["speed"] > firmest["speed"]
    assert fastest["margin"] < 0.0 < flying["margin"] < firmest["margin"]
    assert [one["flies"] for one in (fastest, flying, firmest)] == [False, True, True]
    assert fastest["drag_reduction"] is None
    assert result["closest"] is None
    for one in (fastest, flying, firmest):
        assert one["order"] < one["order"][::-1]
        assert sorted(one["order"]) == result["spans"]
        state = steady(5, one["order"], coupling=coupling)
        assert one["speed"] == state.balanced_speed[0]
        assert one["margin"] == pytest.approx(state.margin[0], abs=1e-14)


def test_the_physics_is_that_of_the_configuration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "flock.yaml"
    file.write_text("/**:\n  ros__parameters: {oswald_efficiency: 0.5, coupling: all}\n")
    result = json_of(tool, capsys, "--spans", BIRDS, "--config", str(file))
    order = result["firmest"]["order"]
    state = steady(5, order, coupling="all", oswald_efficiency=0.5)
    assert (result["coupling"], result["firmest"]["speed"]) == ("all", state.speed[0])


def test_where_nothing_flies_results_are_null(capsys: pytest.CaptureFixture[str]) -> None:
    result = json_of(tool, capsys, "--spans", "0.7,1,1.4")
    assert (result["orders"], result["flying"]) == (3, 0)
    assert result["fastest_flying"] is result["firmest"] is None
    assert result["closest"]["margin"] < 0.0 < result["fastest"]["speed"]
    told = text_of(tool, capsys, "--spans", "0.7,1,1.4")
    assert "none can fly in formation" in told
    assert "closest to flying" in told
    result = json_of(tool, capsys, "--spans", "0.3,0.3,0.3")
    assert result["fastest"] is result["closest"] is None
    assert "In no order does the thrust" in text_of(tool, capsys, "--spans", "0.3,0.3,0.3")


def test_more_orders_than_are_counted_are_null(capsys: pytest.CaptureFixture[str]) -> None:
    spans = ",".join(f"{1.0 + 0.005 * i:g}" for i in range(12))
    result = json_of(tool, capsys, "--spans", spans)
    assert (result["orders"], result["flying"]) == (239500800, None)
    assert (result["method"], result["algorithm"]) == ("exact", "branch and bound")
    assert "branch and bound proves" in text_of(tool, capsys, "--spans", spans)
    spans = ",".join(f"{1.0 + 0.005 * i:g}" for i in range(11))
    result = json_of(tool, capsys, "--spans", spans, "--coupling", "all")
    assert (result["method"], result["flying"]) == ("local search", None)
    assert not result["firmest"]["proven"]


def test_the_text_tells_what_the_orders_mean(capsys: pytest.CaptureFixture[str]) -> None:
    told = text_of(tool, capsys, "--spans", BIRDS)
    assert "60 orders, 26 can fly in formation" in told
    assert "1.02 1 0.98 0.96 1.04" in told
    assert "The fastest order can't fly in formation. To stay together costs 0.0396 m/s." in told
    assert "The fastest order is the firmest, too." in text_of(tool, capsys, "--spans", "1,1,1")


@pytest.mark.parametrize(
    "spans", [BIRDS, "1,1", "0.7,1,1.4", "0.3,0.3", "1,1.01,1.02,1.03,1.04,1.05,1.06"]
)
@pytest.mark.parametrize("counted", [0, 2_000_000])
def test_orders_are_drawn(
    spans: str,
    counted: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(arrange_module, "MOST_COUNTED", counted)
    output = tmp_path / "orders.svg"
    told = text_of(tool, capsys, "--spans", spans, "--output", str(output))
    assert f"drawn: {output}" in told
    picture = output.read_text()
    assert picture.startswith("<?xml")
    assert len(picture) > 10000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "--spans"),
        (("--spans", ""), "'': has 1 value; must have 2 to 60 span ratios"),
        (("--spans", "1"), "has 1 value; must have 2 to 60 span ratios"),
        (("--spans", "1,"), "'' must be a span ratio from 0.01 to 100"),
        (("--spans", "1,big"), "'big' must be a span ratio"),
        (("--spans", "1,nan"), "'nan' must be a span ratio"),
        (("--spans", "1,inf"), "'inf' must be a span ratio"),
        (("--spans", "1,1e400"), "'1e400' must be a span ratio"),
        (("--spans=-1,1",), "'-1' must be a span ratio"),
        (("--spans", "1,0"), "'0' must be a span ratio"),
        (("--spans", "1\n,x\n"), "must be a span ratio"),
        (("--spans", ",".join(["1"] * 5000)), "has 5000 values; must have 2 to 60"),
        (("--spans", ",".join(["1"] * 26), "--coupling", "all"), "2 to 25 span ratios with all"),
        (("--spans", BIRDS, "--coupling", "some"), "coupling"),
        (("--spans", BIRDS, "--birds", "5"), "unrecognized arguments: --birds"),
        (("--spans", BIRDS, "--output", "orders.doc"), "must end in one of"),
        (("--spans", BIRDS, "--config", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_bad_input_is_one_line(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in error_of(tool, capsys, *arguments)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ('span_ratios: ["4=1.05"]', "leave the key out"),
        ('links: ["linear:delay=2"]', "arrange solves the exact coupling"),
        ('forcing: ["gust:std=1"]', "arrange solves the flight without forces"),
    ],
)
def test_a_configuration_that_says_otherwise_is_refused(
    parameters: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "flock.yaml"
    file.write_text(f"/**:\n  ros__parameters:\n    {parameters}\n")
    assert message in error_of(tool, capsys, "--spans", BIRDS, "--config", str(file))


def test_the_largest_flocks_are_searched(capsys: pytest.CaptureFixture[str]) -> None:
    spans = ",".join(["1"] * (MOST_BIRDS["nearest"] - 2) + ["1.01", "1.02"])
    result = json_of(tool, capsys, "--spans", spans)
    assert result["method"] == "exact"
    assert np.isfinite(result["firmest"]["margin"])
