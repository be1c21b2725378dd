# SPDX-License-Identifier: Apache-2.0
"""A smoke test for `colcon test`: a recorded flight, read again, against closed forms."""

from math import log, pi
from pathlib import Path

import pytest

from flock_sim.commands.reference import tool
from flock_tools import load


def test_a_recorded_pair_saves_the_drag_of_the_closed_form(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert tool(["--birds", "2", "--t-max", "50", "--output", str(run)]) == 0
    flown = load(run)
    assert flown.time.values.tolist() == [0, 10, 20, 30, 40, 50]
    # At the start both fly at U_0: eta_1 + eta_2 = -(4 e_O / pi^2) E / (U_0^4 + 1).
    even = log(1 - (pi / 2) ** 2 / (1 + pi / 4) ** 2)
    saved = -4 * 0.8 / pi**2 * even / ((18.5 / 18.0) ** 4 + 1)
    assert float(flown.drag_reduction[0].sum()) == pytest.approx(saved, rel=1e-12)
