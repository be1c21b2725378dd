# SPDX-License-Identifier: Apache-2.0
"""`equilibrium` prints the specified JSON, and describes the result in words."""

from pathlib import Path

import numpy as np
import pytest

from flock_tools.commands.equilibrium import birds_told, tool
from support.tool_runs import error_of, json_of, text_of

LISTS = {
    *("exists", "speed", "margin", "stable", "weakest_gap", "leading_eigenvalue"),
    *("spacing", "share", "drag_reduction"),
}


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_the_json_is_the_contract(coupling: str, capsys: pytest.CaptureFixture[str]) -> None:
    # Member 3: its leader is far too small.
    found = json_of(
        tool, capsys, "--birds", "5", "--coupling", coupling, "--span-ratio", "3=1.0,1.05,0.55"
    )
    assert found.keys() >= LISTS
    shapes = {
        **dict.fromkeys(("exists", "speed", "margin", "stable", "weakest_gap"), (3,)),
        **dict.fromkeys(("spacing", "share"), (3, 4)),
        "drag_reduction": (3, 5),
        "leading_eigenvalue": (3, 2),
    }
    assert {key: np.shape(found[key]) for key in shapes} == shapes
    assert found["exists"] == [True, True, False]
    assert found["stable"] == [True, True, False]
    for m in (0, 1):
        share = np.array(found["share"][m])
        assert np.all((share > 0.0) & (share < 1.0))
        least = np.minimum(share, 1.0 - share).min()
        # With all-to-all coupling, both tails are nearer to falling behind than either is.
        assert (
            0.0 < found["margin"][m] < least if coupling == "all" else found["margin"][m] == least
        )
        assert found["leading_eigenvalue"][m][0] < 0.0
        assert found["parts"][m] == [[1, 2, 3, 4, 5]]
    assert found["margin"][2] < 0.0
    assert found["speed"][2] is None
    assert found["spacing"][2] == [None] * 4
    assert found["leading_eigenvalue"][2] == [None, None]
    assert found["parts"][2][-1] == [3]
    if coupling == "nearest":
        assert found["weakest_gap"][2] in (2, 3)
        assert found["worst_set"] == [[1], [1], [3, 4, 5]]
    else:
        assert found["weakest_gap"] == [None, None, None]
        assert found["worst_set"] == [[1, 5], [1, 5], [3]]


def test_a_steady_state_is_that_of_a_flock_that_nobody_pushes(
    capsys: pytest.CaptureFixture[str],
) -> None:
    calm = json_of(tool, capsys, "--birds", "5")
    push = ("--perturb", "5@10=1e3", "--dt", "0.5")
    notes = "note: --perturb, --dt: no effect on the result of this tool\n"
    assert json_of(tool, capsys, "--birds", "5", *push, notes=notes) == calm
    assert "bird 6" in error_of(tool, capsys, "--birds", "5", "--perturb", "6@10=1e3")


def test_a_bird_alone_has_its_own_speed_and_no_gap(capsys: pytest.CaptureFixture[str]) -> None:
    found = json_of(tool, capsys, "--birds", "1")
    assert found["speed"] == pytest.approx([18.5 / 18.0], rel=1e-14)
    assert (found["spacing"], found["share"], found["weakest_gap"]) == ([[]], [[]], [None])
    assert found["worst_set"] == [[]]
    assert (found["exists"], found["stable"], found["margin"]) == ([True], [True], [None])
    assert found["drag_reduction"] == [[0.0]]
    assert "flies alone, stable" in text_of(tool, capsys, "--birds", "1")


def test_a_formation_is_told_with_its_weakest_gap(capsys: pytest.CaptureFixture[str]) -> None:
    text = text_of(tool, capsys, "--birds", "7")
    assert "7 birds, nearest coupling" in text
    assert "can fly in formation, stable" in text
    # The closed form: D/C of gap i is 1 - i/N.
    assert "weakest gap          1, between birds 1 and 2: share 0.8571, margin 0.1429" in text


def test_what_parts_is_told_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    text = text_of(tool, capsys, "--birds", "7", "--span-ratio", "4=0.6")
    assert "no formation: gap 3 opens, between birds 3 and 4" in text
    assert "birds 1 to 3; birds 5 to 7; bird 4" in text


def test_the_margin_is_that_of_the_worst_set_of_all(capsys: pytest.CaptureFixture[str]) -> None:
    # The leader is so small that it almost falls behind. The shares of birds 1..i do not show it.
    flock = ("--birds", "7", "--coupling", "all", "--span-ratio", "4=0.8004")
    found = json_of(tool, capsys, *flock)
    share = np.array(found["share"][0])
    assert np.minimum(share, 1.0 - share).min() == pytest.approx(0.1947, abs=5e-5)
    assert found["margin"][0] == pytest.approx(1.168e-4, abs=5e-8)
    assert (found["exists"], found["worst_set"]) == ([True], [[4]])
    assert found["weakest_gap"] == [None]
    text = text_of(tool, capsys, *flock)
    assert "weakest set          bird 4 falls behind the others first: margin 0.0001168" in text


@pytest.mark.parametrize(
    ("ratio", "verdict", "worst"),
    [
        ("4=0.7", "bird 4 falls behind the others", [4]),
        ("4=1.12", "bird 4 gets ahead of the others", [1, 2, 3, 5, 6, 7]),
        ("1=0.8", "gap 1 opens, between birds 1 and 2", [1]),
    ],
)
def test_a_set_that_is_not_at_one_side_of_a_gap_is_told(
    ratio: str, verdict: str, worst: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    flock = ("--birds", "7", "--coupling", "all", "--span-ratio", ratio)
    assert f"no formation: {verdict}" in text_of(tool, capsys, *flock)
    found = json_of(tool, capsys, *flock)
    assert found["worst_set"] == [worst]
    assert found["weakest_gap"] == [1 if worst == [1] else None]
    assert found["margin"][0] < 0.0


def test_so_close_to_a_limit_that_speeds_are_equal_the_worst_set_parts(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # The limit of this leader is 0.80035332336887.
    flock = ("--birds", "7", "--coupling", "all", "--span-ratio", "4=0.8003533233688")
    found = json_of(tool, capsys, *flock)
    assert -1e-12 < found["margin"][0] < 0.0
    assert found["parts"] == [[[1, 2, 3, 5, 6, 7], [4]]]


def test_a_flock_without_a_speed_is_told_so(capsys: pytest.CaptureFixture[str]) -> None:
    # Below lambda H_0 = 1 a bird alone has no cruising speed, and here no neighbour saves enough.
    small = [f"--span-ratio={bird}=0.55" for bird in (1, 2)]
    assert "at no speed does the thrust balance the drag" in text_of(
        tool, capsys, "--birds", "2", *small
    )
    found = json_of(tool, capsys, "--birds", "2", *small)
    assert (found["exists"], found["margin"], found["weakest_gap"]) == ([False], [None], [None])
    assert (found["parts"], found["worst_set"]) == ([[]], [[]])


@pytest.mark.parametrize("ratio", ["1.0747244880", "1.0747244878846", "0.956787155", "0.9567871"])
def test_just_beyond_a_limit_somebody_parts(ratio: str, capsys: pytest.CaptureFixture[str]) -> None:
    # The limits of bird 4 of 13 are 0.95678715503 and 1.07472448791.
    found = json_of(tool, capsys, "--span-ratio", f"4={ratio}")
    text = text_of(tool, capsys, "--span-ratio", f"4={ratio}")
    if found["exists"] == [True]:
        assert found["margin"][0] < 1e-9
        return
    assert "opens, between birds" in text
    assert len(found["parts"][0]) >= 2
    assert found["weakest_gap"][0] in range(1, 13)


def test_a_bird_that_nothing_damps_is_neutral(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # At U_0 = U_min drag does not depend on speed to first order.
    path = tmp_path / "bird.yaml"
    path.write_text("/**:\n  ros__parameters:\n    birds: 1\n    cruise_speed: 18.0\n")
    assert "neither decays nor grows" in text_of(tool, capsys, "--config", str(path))


def test_numbers_beyond_all_measure_are_no_crash(
    capsys: pytest.CaptureFixture[str], recwarn: pytest.WarningsRecorder
) -> None:
    json_of(tool, capsys, "--birds", "3", "--span-ratio", "2=1e200,1e-5,50")
    assert not recwarn.list


def test_many_members_are_summed_up(capsys: pytest.CaptureFixture[str]) -> None:
    ratios = ",".join(f"{1.0 + 0.02 * k:g}" for k in range(20))
    text = text_of(tool, capsys, "--birds", "5", "--span-ratio", f"3={ratios}")
    assert "... and 8 members more" in text
    # The upper limit of an interior bird is 1.0747: members of 1, 1.02, 1.04 and 1.06 fly.
    assert text.splitlines()[-1] == "4 of 20 members can fly in formation"


@pytest.mark.parametrize(
    ("birds", "text"),
    [
        ([3], "bird 3"),
        ([1, 2], "birds 1 and 2"),
        ([1, 2, 3], "birds 1 to 3"),
        ([1, 2, 3, 7], "birds 1 to 3 and 7"),
        ([1, 3, 5, 6, 7, 8], "birds 1, 3 and 5 to 8"),
    ],
)
def test_birds_are_listed_in_words(birds: list[int], text: str) -> None:
    assert birds_told(birds) == text


def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert error_of(tool, capsys, "--birds", "0") == "error: birds = 0: must be 1 or more\n"
    assert "unrecognized arguments: --bird 3" in error_of(tool, capsys, "--bird", "3")


def test_a_steady_state_over_links_that_are_not_exact_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for link in ("hold", "exact:delay=3", "2->3=linear"):
        error = error_of(tool, capsys, "--birds", "5", "--link", link)
        assert f"links {link}: equilibrium solves the exact coupling" in error
    assert json_of(tool, capsys, "--birds", "5", "--link", "exact") == json_of(
        tool, capsys, "--birds", "5"
    )
