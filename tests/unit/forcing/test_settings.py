# SPDX-License-Identifier: Apache-2.0
"""Forcing terms are set as written. Impossible ones are refused in one line with a remedy."""

from __future__ import annotations

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.forcing.forcing_table import MOST_TERMS
from flock_sim.forcing.settings import read
from flock_sim.reference.integrator import Reference

# forcing -> words of the message: the value, the range, the fix
REFUSED = [
    (["gsut:std=1"], ["unknown model 'gsut'", "did you mean 'gust'?", "constant, sine, keeper"]),
    (["4=gsut:std=1"], ["unknown model 'gsut'", "did you mean 'gust'?"]),
    ([":std=1"], ["':std=1'", "[BIRD=]MODEL", "gust:std=2e-5"]),
    (["4="], ["'4='", "[BIRD=]MODEL"]),
    (["4:gust=1"], ["unknown model '4'", "known are constant"]),
    (["tail=gust:std=1"], ["unknown model 'tail=gust'", "did you mean"]),
    (["gust:sdt=1"], ["unknown key 'sdt'", "did you mean 'std'?", "time, seed"]),
    (["gust:std=1,"], ["unknown key ''", "known are std, time, seed"]),
    (["gust:std=1,std=2"], ["std is given twice", "leave one out"]),
    (["gust"], ["std is missing", "give std=VALUE"]),
    (["gust:"], ["std is missing"]),
    (["constant"], ["force is missing", "give force=VALUE"]),
    (["sine:amplitude=1"], ["period is missing", "give period=VALUE"]),
    (["keeper:gap=1"], ["stiffness is missing"]),
    (["constant:force="], ["force= must be a finite number"]),
    (["constant:force"], ["force= must be a finite number"]),
    (["constant:force=much"], ["force=much must be a finite number"]),
    (["constant:force=nan"], ["force=nan must be a finite number"]),
    (["constant:force=1/inf"], ["force=inf must be a finite number"]),
    (["sine:amplitude=1,period=0"], ["period=0 must be finite, above 0"]),
    (["sine:amplitude=1,period=-3"], ["period=-3 must be finite, above 0"]),
    (["sine:amplitude=1,period=inf"], ["period=inf must be finite"]),
    (["keeper:gap=1,stiffness=-1"], ["stiffness=-1 must be finite, 0 or more"]),
    (["keeper:gap=1,stiffness=1,damping=-2"], ["damping=-2 must be finite, 0 or more"]),
    (["gust:std=-1"], ["std=-1 must be finite, 0 or more"]),
    (["gust:std=1,time=0"], ["time=0 must be above 0, 1e+12 or less"]),
    (["gust:std=1,time=1e13"], ["time=1e13 must be above 0, 1e+12 or less"]),
    (["gust:std=1,seed=0.5"], ["seed=0.5 must be a whole number, 0..2^53"]),
    (["gust:std=1,seed=-1"], ["seed=-1 must be a whole number"]),
    (["0=gust:std=1"], ["bird 0 is not among 1..13"]),
    (["14=gust:std=1"], ["bird 14 is not among 1..13"]),
    (["-1=gust:std=1"], ["bird -1 is not among 1..13"]),
    (["gust:std=1/2/3,time=4/5"], ["time has 2 values and std 3", "give 1 or 3"]),
    (["gust:std=1/2", "3=constant:force=1/2/3"], ["has 3 members", "has 2", "give 1 or 2"]),
    ((MOST_TERMS + 1) * ["constant:force=0"], ["forcing has 65 entries", "64 or fewer"]),
]


@pytest.mark.parametrize(("forcing", "words"), REFUSED)
def test_a_term_that_can_not_be_is_refused_in_one_line(forcing, words):
    with pytest.raises(FlockError) as caught:
        FlockConfiguration.given({"forcing": forcing})
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_status == 2
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    ("entry", "bird", "name", "items"),
    [
        ("gust:std=2e-5,seed=7", None, "gust", (("std", "2e-5"), ("seed", "7"))),
        (
            "7=sine:amplitude=1/2,period=4",
            7,
            "sine",
            (("amplitude", "1/2"), ("period", "4")),
        ),
        ("laws.py:keeper", None, "laws.py:keeper", ()),
        ("../my laws/a=1.py:pi:gap=0.8", None, "../my laws/a=1.py:pi", (("gap", "0.8"),)),
        ("3=/home/me/laws.py:keeper:gap=1", 3, "/home/me/laws.py:keeper", (("gap", "1"),)),
        ("autopilot:speed=1.03", None, "autopilot", (("speed", "1.03"),)),
        ("autopilot", None, "autopilot", ()),
    ],
)
def test_a_term_is_read_as_it_is_written(entry, bird, name, items):
    settings = read(entry)
    assert (settings.bird, settings.name, settings.items) == (bird, name, items)
    assert settings.text == entry


def test_to_read_a_configuration_loads_no_law():
    configuration = FlockConfiguration.from_parameters({"forcing": ["/nowhere/laws.py:law:a=1"]})
    assert configuration.forcing_table.names == ("/nowhere/laws.py:law",)
    assert configuration.members == 1
    with pytest.raises(FlockError, match=r"law '/nowhere/laws\.py:law' is not loaded") as caught:
        Reference(configuration)
    assert "FlockConfiguration.given" in str(caught.value)


def test_values_are_those_of_the_members_or_the_defaults():
    values = read("keeper:gap=1/2,stiffness=0.5").values(2)
    assert values["gap"].tolist() == [1.0, 2.0]
    assert values["stiffness"].tolist() == [0.5, 0.5]
    assert values["damping"] is None
    assert read("sine:amplitude=1,period=2").values(3)["phase"].tolist() == [0.0, 0.0, 0.0]
    assert read("gust:std=1").values(1)["seed"].tolist() == [0.0]


def test_terms_of_a_bird_are_those_of_all_birds_and_its_own_in_their_order():
    entries = ("3=constant:force=1", "gust:std=1", "2=constant:force=2", "3=gust:std=3")
    table = FlockConfiguration(forcing=entries).forcing_table
    assert [settings.text for settings in table.of(3)] == [entries[0], entries[1], entries[3]]
    assert [settings.text for settings in table.of(2)] == [entries[1], entries[2]]
    assert [settings.text for settings in table.of(1)] == [entries[1]]
    assert table.names == ("constant", "gust")


def test_all_birds_have_the_state_numbers_of_the_bird_with_most():
    entries = ("gust:std=1,time=5", "3=gust:std=1,time=2", "2=gust:std=1")
    table = FlockConfiguration(forcing=entries).forcing_table
    assert [table.state_numbers(bird) for bird in (1, 2, 3)] == [1, 1, 2]
    assert table.states == 2
    assert FlockConfiguration(forcing=("gust:std=1",)).forcing_table.states == 0
    assert FlockConfiguration().forcing_table.states == 0


def test_forcing_makes_members_as_span_ratios_and_links_do():
    configuration = FlockConfiguration(
        span_ratios=("4=0.9",), forcing=("gust:std=1/2/3",), links=("hold:delay=1",)
    )
    assert configuration.members == 3
    assert np.array_equal(configuration.span_ratio[3], [0.9] * 3)


@pytest.mark.parametrize(
    ("others", "told"),
    [
        ({"span_ratios": ("4=0.9,1,1.1",)}, "span_ratios have 3"),
        ({"links": ("hold:delay=1/2/3",)}, "link 'hold:delay=1/2/3' has 3"),
    ],
)
def test_members_of_forcing_and_of_all_else_must_be_as_many(others, told):
    with pytest.raises(FlockError, match=r"forcing 'gust:std=1/2' has 2 members") as caught:
        FlockConfiguration(forcing=("gust:std=1/2",), **others)
    assert told in str(caught.value)
    assert "give 1 or 3" in str(caught.value)
