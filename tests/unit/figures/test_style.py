# SPDX-License-Identifier: Apache-2.0
"""A title tells birds, coupling, links and spans."""

from __future__ import annotations

import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_tools.figures.style import LINE, flock_name

LATE = "linear:delay=5/7,drop=0.1,speed_noise=0.01"
MANY = ("hold", "2->3=exact", "3->2=linear", "4->3=hold")


def test_a_title_tells_that_links_are_exact() -> None:
    assert flock_name(FlockConfiguration(), 0) == (
        "13 birds, nearest-neighbour coupling, exact links"
    )
    flock = FlockConfiguration(birds=3, coupling="all", span_ratios=("1=0.9",))
    assert flock_name(flock, 0) == "3 birds, all-to-all coupling, exact links, $\\lambda_{1}$ = 0.9"
    assert flock_name(FlockConfiguration(birds=1), 0) == "1 bird"


def test_a_title_tells_the_links_of_its_member_with_names_and_units() -> None:
    flock = FlockConfiguration(birds=5, span_ratios=("2=0.9,1.0",), links=(LATE,))
    name, links = flock_name(flock, 1).split("\n", 1)
    assert name == "5 birds, nearest-neighbour coupling, member 2 of 2"
    assert " ".join(links.split()) == (
        "links: linear with delay 7 steps, probability of loss 0.1, "
        "noise of speed 0.01 $U_\\mathrm{min}$"
    )
    assert "delay 5 steps" in flock_name(flock, 0)


@pytest.mark.parametrize(
    ("links", "told"),
    [
        (("hold:interval=10",), "links: hold with interval of messages 10 steps"),
        (("hold",), "links: hold"),
        (("2->3=linear:noise=0.1",), "bird 2 to bird 3: linear with noise of position and speed"),
        (MANY, "links: hold; bird 2 to bird 3: exact; 2 more"),
    ],
)
def test_single_links_are_named_and_many_are_counted(links: tuple[str, ...], told: str) -> None:
    assert told in flock_name(FlockConfiguration(birds=5, links=links), 0).replace("\n", " ")


def test_a_long_title_has_several_lines() -> None:
    links = ("linear:delay=5,jitter=3,drop=0.1,range=20,timeout=100,seed=7", "2->3=hold:interval=7")
    lines = flock_name(FlockConfiguration(birds=5, links=links), 0).split("\n")
    assert len(lines) > 2
    assert max(len(line) for line in lines) <= LINE


def test_a_title_tells_the_forcing_of_its_member() -> None:
    forcing = ("gust:std=1e-5/2e-5,seed=7", "3=laws/mine.py:keeper:gap=0.8")
    name, told = flock_name(FlockConfiguration(birds=5, forcing=forcing), 1).split("\n", 1)
    assert "member 2 of 2" in name
    assert told.replace("\n", " ") == (
        "forcing: gust with std 2e-5, seed 7; bird 3: keeper with gap 0.8"
    )
    many = FlockConfiguration(birds=5, forcing=5 * ("constant:force=1e-4",))
    assert "3 more" in flock_name(many, 0)
