# SPDX-License-Identifier: Apache-2.0
"""A sweep varies the parameters of forcing, and loses no force of its flock."""

from __future__ import annotations

from typing import Any

import pytest

from flock_sim.errors import FlockError
from flock_tools.experiments.sweep.members import Member, merged
from flock_tools.experiments.sweep.specification import Sweep, sweep

FORCING = ["gust:std=1e-5,seed=3", "2=keeper:gap=0.8,stiffness=0.01", "2=gust:std=2e-5"]


def swept(**axes: Any) -> Sweep:
    return sweep({"flock": {"birds": 3, "t_max": 20.0, "forcing": FORCING}, "axes": axes})


def flown(**axes: Any) -> tuple[str, ...]:
    """The forcing of the one flight in which all members fly."""
    (flight,) = swept(**axes).flights(at_once=100)
    return flight.configuration.forcing


def test_an_axis_varies_all_entries_of_a_law_or_those_of_a_bird() -> None:
    assert flown(**{"forcing.gust.std": [0.0, 1e-4]}) == (
        "gust:std=0/0.0001,seed=3",
        FORCING[1],
        "2=gust:std=0/0.0001",
    )
    assert flown(**{"forcing[2].gust.std": [0.0, 1e-4]}) == (*FORCING[:2], "2=gust:std=0/0.0001")
    assert flown(**{"forcing.keeper.damping": [0.0, 1.0]}) == (
        FORCING[0],
        "2=keeper:gap=0.8,stiffness=0.01,damping=0/1",
        FORCING[2],
    )


def test_other_axes_keep_the_forcing() -> None:
    assert flown(**{"span_ratio[1]": [0.9, 1.0]}) == tuple(FORCING)


def test_two_axes_of_forcing_give_each_member_its_values() -> None:
    axes = {"forcing.gust.seed": [1, 2], "forcing.keeper.gap": [0.5, 0.7]}
    assert flown(**axes)[:2] == (
        "gust:std=1e-5,seed=1/1/2/2",
        "2=keeper:gap=0.5/0.7/0.5/0.7,stiffness=0.01",
    )


def test_a_member_has_the_configuration_that_it_was_made_of() -> None:
    flock = swept(**{"span_ratio[1]": [1.0]}).flock
    assert merged([Member.of(flock)]).forcing == flock.forcing == tuple(FORCING)


@pytest.mark.parametrize(
    ("axis", "told"),
    [
        ("forcing.sine.period", "no entry of `forcing` has the law 'sine'"),
        ("forcing[1].keeper.gap", "no entry of `forcing` has the law 'keeper' of bird 1"),
        ("forcing.gust.strength", "unknown key 'strength'"),
        ("forcing.gust.time", "must be above 0"),
        ("forcing.gust", "did you mean 'forcing.LAW.KEY'"),
    ],
)
def test_an_axis_that_no_force_has_is_refused(axis: str, told: str) -> None:
    with pytest.raises(FlockError, match=r".") as refused:
        swept(**{axis: [0.0, 1.0]}).members()
    assert told in str(refused.value)
