# SPDX-License-Identifier: Apache-2.0
"""The verdict is right for flights that are hard to judge, and is never given too early."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flock_sim.analysis.flight_verdict import Flown
from flock_sim.analysis.verdict import (
    APART,
    FEWEST_ROWS,
    HOLDS,
    SETTLING,
    STALLED,
    Verdicts,
    evenly,
    judge,
)
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.reference.integrator import Reference
from flock_sim.theory.equilibrium import equilibrium

LATE = ("hold:interval=10",)


def flown(t_max: float, **flock: Any) -> Verdicts:
    """The verdicts on a flight that is recorded 1000 times, or at every step if it is shorter."""
    every = max(1, round(t_max / flock.get("dt", 1.0) / 1000.0))
    configuration = FlockConfiguration(t_max=t_max, record_every=every, **flock)
    with np.errstate(all="ignore"):
        return Flown(configuration, list(Reference(configuration).fly())).verdicts()


HARD: list[tuple[str, str, float, dict[str, Any]]] = [
    # 1. It rings down: at t = 10^4 its gaps still swing by 0.3 b, and less from quarter to quarter.
    ("rare messages, early", SETTLING, 1e4, {"birds": 7, "links": LATE}),
    # 2. The same flock at t = 10^5: no gap moves, although sigma_U stays above 1e-6.
    ("rare messages, late", HOLDS, 1e5, {"birds": 7, "links": LATE}),
    # 3. Gaps fluctuate by 0.6 b, and sigma_U stays at 7e-4, above the paper's 1e-4: no gap grows.
    ("loss 0.2", HOLDS, 1e5, {"birds": 7, "links": ("hold:drop=0.2",)}),
    # 4. Gaps fluctuate by 50 b about some 5 b; each time the birds come back.
    ("loss 0.9, held", HOLDS, 1e5, {"birds": 7, "links": ("hold:drop=0.9",)}),
    # 5. Bird 3 is too small: losses do not hide that it leaves.
    (
        "loss 0.9, bird 3 small",
        APART,
        3e4,
        {"birds": 7, "links": ("linear:drop=0.9",), "span_ratios": ("3=0.7",)},
    ),
    # 6. Exponential approach to 8.9 b with a time constant of 2 10^4: it ends 0.07 b before.
    ("delay 50, held", HOLDS, 1e5, {"birds": 3, "links": ("hold:delay=50",)}),
    # 7. The same at t = 3 10^4: the gaps still grow by 1 b in a quarter of the flight.
    ("delay 50, held, early", SETTLING, 3e4, {"birds": 3, "links": ("hold:delay=50",)}),
    # 8. Beyond the critical lag the gaps swing by 1.3 b for ever (sigma_U 3e-3).
    ("limit cycle", HOLDS, 1e5, {"birds": 3, "links": ("linear:delay=43",)}),
    # 9. Just beyond the limit 0.9920...: at first the gap grows as slowly as one that settles.
    ("slow escape, early", SETTLING, 1e4, {"birds": 13, "span_ratios": ("1=0.9909",)}),
    # 10. The same at t = 10^5: gap 49 b, 9/10 of its speed last. sigma_U is below 1e-4 there.
    ("slow escape", APART, 1e5, {"birds": 13, "span_ratios": ("1=0.9909",)}),
    # 11. A bird 300 b behind comes back; its gaps are wide and change steadily for long.
    ("far behind", SETTLING, 1e4, {"birds": 7, "perturbations": ("2@2000=-300,0",)}),
    # 12. Bird 1 is pushed to 0.4 U_min, loses its speed, and leaps over the pole of U^-2.
    ("stalled", STALLED, 3e3, {"birds": 3, "perturbations": ("1@500=0,-0.72",)}),
]


@pytest.mark.parametrize(
    ("word", "t_max", "flock"), [case[1:] for case in HARD], ids=[c[0] for c in HARD]
)
def test_a_hard_flight_gets_the_right_verdict(word: str, t_max: float, flock: Any) -> None:
    found = flown(t_max, **flock)
    assert found.verdict == [word], found.verdict_reason


def test_a_stalled_bird_is_named_and_other_members_go_on() -> None:
    configuration = FlockConfiguration(
        birds=3, t_max=3000.0, span_ratios=("2=1,1",), perturbations=("1:2@500=0,-0.72",)
    )
    states = list(Reference(configuration).fly())
    found = Flown(configuration, states).verdicts()
    first = next(state for state in states if state.speed[0, 1] <= 0.0)
    assert found.verdict == [SETTLING, STALLED]
    assert found.stalled_bird == [None, 1]
    assert found.stalled_at == [None, first.time]


def test_a_bird_that_was_pushed_back_over_the_pole_has_stalled() -> None:
    pushes = ("1@500=0,-0.72", "1@1000=0,3")
    configuration = FlockConfiguration(birds=3, t_max=1500.0, perturbations=pushes)
    states = list(Reference(configuration).fly())
    assert (states[-1].speed > 0.0).all()
    assert Flown(configuration, states).verdicts().stalled_bird == [1]


def test_speeds_that_are_not_finite_are_a_stall() -> None:
    with np.errstate(all="ignore"):
        assert flown(1e7, birds=3, dt=1e6).verdict == [STALLED]


def test_no_word_contradicts_theory() -> None:
    """120 flocks near their limits: where a state exists none is apart, elsewhere none holds."""
    rng = np.random.default_rng(7)
    birds, members = 5, 120
    ratios = np.round(rng.uniform(0.9, 1.1, (birds, members)), 4)
    configuration = FlockConfiguration(
        birds=birds,
        t_max=2e4,
        record_every=100,
        span_ratios=tuple(
            f"{i + 1}={','.join(map(str, row))}" for i, row in enumerate(ratios.tolist())
        ),
    )
    exists = np.isfinite(equilibrium(Flock.of(configuration)).speed)
    states = list(Reference(configuration).fly())
    for last in (len(states) // 4, len(states) // 2, len(states) - 1):
        part = replace(configuration, t_max=states[last].time)
        words = np.array(Flown(part, states[: last + 1]).verdicts().verdict)
        assert not (words[exists] == APART).any()
        assert not (words[~exists] == HOLDS).any()
    assert (words != SETTLING).mean() > 0.8


def test_a_short_or_sparse_flight_is_settling() -> None:
    position = np.zeros((20, 2, 1))
    time = np.linspace(0.0, 1e4, 20)
    assert judge(time, position, 0.0, 1e3)[0][0] == HOLDS
    assert judge(time, position, 9.5e3, 1e3)[0][0] == SETTLING
    assert judge(time[-FEWEST_ROWS + 1 :], position[-FEWEST_ROWS + 1 :], 0.0, 1e3)[0][0] == SETTLING
    assert judge(time, position[:, :1], 0.0, 1e9)[0][0] == HOLDS


@pytest.mark.parametrize(("first", "last"), [(0, 0), (0, 199), (0, 200), (3, 1234), (7, 10007)])
def test_rows_are_evenly_spaced_to_the_end(first: int, last: int) -> None:
    rows = evenly(first, last)
    assert len(rows) <= 200
    assert rows[0] >= first
    assert rows[-1] == last
    assert len(set(np.diff(rows))) <= 1
