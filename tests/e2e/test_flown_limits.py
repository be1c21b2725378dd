# SPDX-License-Identifier: Apache-2.0
"""The stability diagram flown by real nodes equals the integrated one."""

from __future__ import annotations

from typing import Any

from support.terminal import Terminal

LARGE_STEPS = ("--dt", 100, "--t-max", 1e5)
"""Steady flight is reached in steps of this size, too: e-folding takes a thousand and more."""

TOO_LARGE_STEPS = ("--dt", 1000, "--t-max", 1e6)
"""No flock is stable in steps like these; of some the speeds overflow."""


def verdicts(result: dict[str, Any]) -> dict[tuple[int, float], tuple[bool, int | None]]:
    """All verdicts on birds and their span ratios: whether it holds, and the gap that opens."""
    return {
        (limits["bird"], tried["span_ratio"]): (tried["holds"], tried["gap"])
        for limits in result["limits"]
        for tried in limits["tried"]
    }


def both(terminal: Terminal, steps: tuple[object, ...], *how: object) -> list[dict[str, Any]]:
    """A diagram of few points: what is flown, and what is integrated."""
    grid = ("--birds", 3, "--points", 5, "--json", *steps)
    methods = (("fly", *how), ("integrate",))
    return [terminal.well("limits", "--method", *method, *grid).json for method in methods]


def test_flown_verdicts_are_those_of_integration_and_of_the_exact_limits(
    terminal: Terminal,
) -> None:
    flown, integrated = both(terminal, LARGE_STEPS, "--bag", "diagram")
    found = verdicts(flown)
    assert list(found) == [(bird, ratio) for bird in (1, 2) for ratio in (0.5, 0.75, 1, 1.25, 1.5)]
    assert found.items() <= verdicts(integrated).items()
    assert flown["as_given"]
    # No point is anywhere near a limit: 0.936 and 1.084 of bird 1, 1.107 of bird 2.
    for limits in terminal.well("limits", "--birds", 3, "--json").json["limits"]:
        low, high = limits["lower"] or 0.0, limits["upper"]
        for (bird, ratio), (holds, _) in found.items():
            assert holds == (low < ratio < high) or bird != limits["bird"]

    assert (flown["members"], flown["member_steps"], flown["processes"]) == (10, 10 * 1000, 2)
    assert {flown[f"{what}_share"] for what in ("kernel", "message", "waiting")} == {None}
    # The bag is one like all others.
    terminal.well("reference", "--repeat", "diagram", "--output", "again")
    assert terminal.well("compare", "diagram", "again", "--json").json["equal"]


def test_members_that_diverge_keep_none_from_flying_on(terminal: Terminal) -> None:
    flown, integrated = both(terminal, (*TOO_LARGE_STEPS, "--bird", 2), "--processes", 3)
    found = verdicts(flown)
    assert found[2, 0.5] == (False, None)  # its speeds are no numbers any more
    assert all(gap for (_, ratio), (_, gap) in found.items() if ratio != 0.5)
    assert found.items() <= verdicts(integrated).items()
    assert not flown["as_given"]
    assert flown["bag"] is None
    assert not list(terminal.directory.iterdir())


def test_a_flock_outside_of_the_grid_flies_along(terminal: Terminal) -> None:
    flock = ("--birds", 2, "--bird", 1, "--between", "0.5,0.6", "--points", 2)
    done = terminal.well("limits", "--method", "fly", *flock, "--t-max", 100, "--processes", 1)
    assert "3 members at once" in done.stdout


def test_an_interrupted_diagram_leaves_nothing(terminal: Terminal) -> None:
    job = terminal.start("limits", "--method", "fly", "--birds", 2, "--t-max", 1e6)
    job.until(lambda: list(terminal.temporary.rglob("*.mcap")))
    job.interrupt()
    assert job.wait().status == 130
    assert terminal.left_behind() == []
