# SPDX-License-Identifier: Apache-2.0
"""Valid configurations are flown as written. Others are refused in one line with a remedy."""

import math
from collections.abc import Iterator
from math import inf, nan
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.configuration.flock_configuration import KEYS, MEANING, FlockConfiguration
from flock_sim.errors import FlockError


def configured(**parameters) -> FlockConfiguration:
    return FlockConfiguration.from_parameters(parameters)


def refusal(**parameters) -> str:
    """The one line with which `parameters` are refused."""
    with pytest.raises(FlockError) as caught:
        configured(**parameters)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_status == 2
    return message


# key, value -> words of the message: the value, the range, the fix
REFUSED = [
    ("birds", 0, ["birds = 0", "1 or more"]),
    ("birds", -3, ["birds = -3", "1 or more"]),
    ("birds", "1e308", ["birds = 1e+308: must be 20000 or less"]),
    ("birds", 2.5, ["birds = 2.5", "whole number"]),
    ("birds", "13.5", ["birds = 13.5", "whole number"]),
    ("birds", nan, ["birds = nan", "whole number"]),
    ("birds", "1e999", ["birds = 1e999", "whole number"]),
    ("birds", "many", ["birds = 'many'", "must be a number"]),
    ("birds", True, ["birds = True", "must be a number"]),
    ("birds", None, ["birds = None", "must be a number"]),
    ("birds", 10**400, ["birds = 1000", "000...: must be a number"]),
    ("birds", "9" * 5000, ["birds = 9999", "999...: must be a whole number"]),
    ("record_every", 0, ["record_every = 0", "1 or more"]),
    ("record_every", -1, ["record_every = -1", "1 or more"]),
    ("record_every", 0.5, ["record_every = 0.5", "whole number"]),
    ("coupling", "near", ["coupling = 'near'", "did you mean 'nearest'?", "nearest, all"]),
    ("coupling", "al", ["coupling = 'al'", "did you mean 'all'?"]),
    ("coupling", "", ["coupling = ''", "known are nearest, all"]),
    ("coupling", 3, ["coupling = 3", "must be text"]),
    ("dt", "one", ["dt = 'one'", "must be a number"]),
    ("t_max", [1.0], ["t_max = [1.0]", "must be a number"]),
    ("cruise_speed", 17.9, ["cruise_speed = 17.9", "min_drag_speed", "18 m/s", "or more"]),
    ("min_drag_speed", 18.6, ["cruise_speed = 18.5", "18.6 m/s"]),
    ("min_drag_speed", 18.50000123, ["(18.50000123 m/s) or more"]),
    ("span_ratios", "4=1.05", ["span_ratios = '4=1.05'", 'list such as ["4=1.05"]']),
    ("span_ratios", 4, ["span_ratios = 4", "list such as"]),
    ("span_ratios", [4.0], ["span_ratios = 4.0", "must be text"]),
    ("span_ratios", ["4"], ["'4'", "I=LAMBDA", "such as 4=1.05"]),
    ("span_ratios", ["4="], ["'4='", "I=LAMBDA"]),
    ("span_ratios", ["=1.05"], ["'=1.05'", "I=LAMBDA"]),
    ("span_ratios", ["4=1,"], ["'4=1,'", "I=LAMBDA"]),
    ("span_ratios", ["4=big"], ["'4=big'", "I=LAMBDA"]),
    ("span_ratios", ["4.0=1"], ["'4.0=1'", "I=LAMBDA"]),
    ("span_ratios", ["4=1=2"], ["'4=1=2'", "I=LAMBDA"]),
    ("span_ratios", ["4=0"], ["'4=0'", "0 must be finite and above 0"]),
    ("span_ratios", ["4=-1.5"], ["'4=-1.5'", "-1.5 must be finite and above 0"]),
    ("span_ratios", ["4=nan"], ["'4=nan'", "nan must be finite and above 0"]),
    ("span_ratios", ["4=1,inf"], ["'4=1,inf'", "inf must be finite and above 0"]),
    ("span_ratios", ["0=1"], ["'0=1'", "bird 0 is not among 1..13"]),
    ("span_ratios", ["14=1"], ["'14=1'", "bird 14 is not among 1..13"]),
    ("span_ratios", ["-1=1"], ["'-1=1'", "bird -1 is not among 1..13"]),
    ("span_ratios", ["4=1", "4=2"], ["'4=2'", "bird 4 is given twice", "'4=1'"]),
    (
        "span_ratios",
        ["4=1,2", "5=1,2,3"],
        ["'4=1,2' has 2 members", "'5=1,2,3' has 3", "give 1 or 3"],
    ),
    ("perturbations", "4@5=1", ["perturbations = '4@5=1'", 'list such as ["4@500=0.1,-0.01"]']),
    ("perturbations", [4], ["perturbations = 4", "must be text"]),
    *(
        (
            "perturbations",
            [entry],
            [repr(entry), "BIRD[:MEMBER]@STEP=DPOSITION[,DSPEED]", "such as"],
        )
        for entry in (
            *(
                "4",
                "4@5",
                "4=0.1",
                "@5=1",
                "4@=1",
                "4@5=",
                "4@5=1,",
                "4@5=,1",
                "4@5=1,2,3",
                "4@5=far",
            ),
            *("4:@5=1", ":1@5=1", "4:1:1@5=1", "4@5@6=1", "4@5=1=2", "4.0@5=1", "4:1.0@5=1"),
            *("4@5.5=1", "4@nan=1", "4@inf=1", "four@5=1", "4@5:1=1"),
        )
    ),
    ("perturbations", ["0@5=1"], ["'0@5=1'", "bird 0 is not among 1..13"]),
    ("perturbations", ["14@5=1"], ["'14@5=1'", "bird 14 is not among 1..13"]),
    ("perturbations", ["4:0@5=1"], ["'4:0@5=1'", "member 0 is not among 1..1"]),
    ("perturbations", ["4:2@5=1"], ["'4:2@5=1'", "member 2 is not among 1..1"]),
    ("perturbations", ["4@-1=1"], ["'4@-1=1'", "step -1 is not among 0..10000"]),
    ("perturbations", ["4@10001=1"], ["'4@10001=1'", "step 10001 is not among 0..10000"]),
    (
        "perturbations",
        ["4@1e300=1"],
        ["'4@1e300=1'", "step 10000000000000000525... is not among 0..10000"],
    ),
    ("perturbations", ["9" * 400 + "@5=1"], ["bird 99999999999999999999... is not among 1..13"]),
    ("perturbations", ["4@5=nan"], ["'4@5=nan'", "nan must be finite"]),
    ("perturbations", ["4@5=1,-inf"], ["'4@5=1,-inf'", "-inf must be finite"]),
    ("perturbations", ["4@5=1", "4@5=1e999"], ["'4@5=1e999'", "inf must be finite"]),
    ("span_ratios", ["4=0.5", "5=0.5"], ["0.5 and 0.5", "birds 4 and 5", "more than 1"]),
    ("span_ratios", ["4=1,0.3", "5=1,0.4"], ["0.3 and 0.4", "birds 4 and 5", "more than 1"]),
]


@pytest.mark.parametrize(
    ("key", "value", "words"), REFUSED, ids=[f"{key}={value!r:.20}" for key, value, _ in REFUSED]
)
def test_bad_input_is_refused_naming_value_range_and_fix(key, value, words):
    message = refusal(**{key: value})
    for word in words:
        assert word in message


@pytest.mark.parametrize("value", [0.0, -1.0, nan, inf, -inf])
@pytest.mark.parametrize(
    "key",
    [
        "dt",
        "t_max",
        "body_mass",
        "wing_span",
        "air_density",
        "min_drag_speed",
        "cruise_speed",
        "oswald_efficiency",
        "zero_lift_drag",
        "aspect_ratio",
    ],
)
def test_every_quantity_must_be_finite_and_above_zero(key, value):
    assert f"{key} = {value:g}: must be finite and above 0" in refusal(**{key: value})


@pytest.mark.parametrize(
    ("key", "near"),
    [("bird", "birds"), ("tmax", "t_max"), ("span_ratio", "span_ratios"), ("dT", "dt")],
)
def test_an_unknown_key_is_answered_with_the_nearest_known_one(key, near):
    message = refusal(**{key: 1})
    assert f"unknown parameter {key!r}" in message
    assert f"did you mean {near!r}?" in message


def test_a_key_like_no_other_is_answered_with_all_that_are_known():
    message = refusal(zzzzzz=1)
    assert "did you mean" not in message
    assert all(key in message for key in KEYS)


def test_every_key_has_a_meaning_to_show():
    assert list(KEYS) == list(MEANING) == list(FlockConfiguration().parameters())
    assert all(MEANING.values())


def test_the_page_on_the_model_has_every_key_and_its_default():
    text = (Path(__file__).parents[3] / "docs/model.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| `")]
    told = {cells[0].strip("| `"): cells[1] for cells in rows}
    for key, value in FlockConfiguration().parameters().items():
        assert told[key] == ("none" if value == [] else str(value))


@pytest.mark.parametrize(
    ("t_max", "dt", "fixes"),
    [
        (1.0, 0.3, ["0.9", "1.2"]),
        (10.0, 3.0, ["9", "12"]),
        (0.5, 1.0, ["1", "2"]),
        (1000.5, 1.0, ["1000", "1001"]),
    ],
)
def test_t_max_between_steps_is_refused_with_the_multiples_beside_it(t_max, dt, fixes):
    message = refusal(t_max=t_max, dt=dt)
    assert f"t_max = {t_max:g}: must be a multiple of dt = {dt:g}" in message
    assert f"; {fixes[0]} and {fixes[1]} are" in message
    for fix in fixes:
        configured(t_max=fix, dt=dt)


def drawn_times(count: int) -> Iterator[tuple[float, float]]:
    """Yield step sizes and flight times, most of them no whole number of steps."""
    random = Random(16)
    yield 0.3333333333333333, 10.3333333333
    yield 1.0, 12345678.5  # whose six digits are another whole number
    yield 1e3, 1e3 * 51539607.3  # ROS time ends before the next step
    for _ in range(count):
        dt = random.choice([10.0 ** random.uniform(-4.0, 3.0), random.randint(1, 30) / 3.0])
        steps = 10.0 ** random.uniform(-2.0, 7.0)
        yield dt, dt * random.choice([steps, round(steps) + random.choice([1e-3, 0.5, 1.0 / 3.0])])


def test_every_t_max_that_is_suggested_is_accepted():
    tried = 0
    for dt, t_max in drawn_times(3000):
        try:
            configured(t_max=t_max, dt=dt, record_every=10**6)
        except FlockError as error:
            _, _, fix = str(error).partition(": must be a multiple of dt = ")
        else:
            continue
        assert fix, (dt, t_max)
        suggested = fix.partition("; ")[2].removesuffix(" are").removesuffix(" is").split(" and ")
        beside = [max(1, math.floor(t_max / dt)) + more for more in (0, 1)]
        flown = [configured(t_max=text, dt=dt, record_every=10**6).steps for text in suggested]
        assert flown == beside[: len(flown)], (dt, t_max)
        tried += 1
    assert tried > 2000


def test_every_t_max_below_the_limit_that_is_named_is_accepted():
    for wing_span in np.linspace(1.0, 2.0, 500):
        message = refusal(t_max=1e12, wing_span=float(wing_span))
        limit = float(message.partition("must be below ")[2].partition(",")[0])
        configured(t_max=math.floor(limit - 1), wing_span=float(wing_span))


@pytest.mark.parametrize(("t_max", "dt"), [(1e4, 5e-324), (1e308, 1e-10), (1.0, 1e-309)])
def test_more_steps_than_a_number_holds_are_refused(t_max, dt):
    assert "t_max" in refusal(t_max=t_max, dt=dt)


@given(steps=st.integers(1, 10**7), dt=st.decimals("0.001", "99", places=3))
def test_decimals_that_multiply_are_taken_as_such(steps, dt):
    # What is written exactly in decimals is a whole number of steps, however binary rounds it.
    configuration = configured(t_max=str(steps * dt), dt=str(dt))
    assert configuration.steps == steps


# A thousandth of a step in 10^5 is 1e-8 of the flight: no rounding of decimals comes near.
@given(steps=st.integers(1, 10**5), part=st.floats(0.001, 0.999), dt=st.floats(1e-3, 1e2))
def test_a_broken_step_is_never_taken_for_a_whole_one(steps, part, dt):
    refusal(t_max=(steps + part) * dt, dt=dt)


def test_defaults_are_thirteen_geese():
    configuration = FlockConfiguration()
    assert (configuration.birds, configuration.members, configuration.steps) == (13, 1, 10000)
    np.testing.assert_array_equal(configuration.span_ratio, np.ones((13, 1)))


@pytest.mark.parametrize(
    ("text", "number"), [("1e4", 1e4), ("10000", 1e4), (" 10000.0 ", 1e4), (10000, 1e4)]
)
def test_numbers_may_be_text(text, number):
    assert configured(t_max=text).t_max == number
    assert configured(birds=text, t_max=1.0).birds == number
    assert isinstance(configured(record_every=text).record_every, int)


def test_an_empty_entry_is_none():
    # ROS has no empty list of strings: [""] stands for it.
    assert configured(span_ratios=[""], perturbations=[""]) == FlockConfiguration()


def test_one_value_holds_for_all_members():
    configuration = configured(birds=4, span_ratios=["2=0.9,1.0,1.1", "4=1.2"])
    assert configuration.members == 3
    np.testing.assert_array_equal(
        configuration.span_ratio,
        [[1.0, 1.0, 1.0], [0.9, 1.0, 1.1], [1.0, 1.0, 1.0], [1.2, 1.2, 1.2]],
    )


def test_a_single_bird_may_have_any_size():
    assert configured(birds=1, span_ratios=["1=0.01"]).span_ratio[0, 0] == 0.01


def test_too_small_a_bird_for_solo_flight_may_fly_in_a_flock():
    assert configured(span_ratios=["4=0.9"]).span_ratio[3, 0] == 0.9


def test_time_and_stamp_count_from_the_first_step():
    configuration = configured(dt=0.5, t_max=1000.0)
    # b / U_min = 0.75 m / 18 m/s = 1/24 s; 36 steps of half of it are 0.75 s.
    assert configuration.second == 0.75 / 18.0
    assert configuration.time(36) == 18.0
    assert configuration.stamp(0) == 0
    assert configuration.stamp(36) == 750_000_000


def test_recorded_states_must_have_stamps_of_their_own():
    with pytest.raises(FlockError, match="less than 2 ns apart"):
        FlockConfiguration(dt=1e-10, t_max=1e-8)


def test_more_birds_than_a_bag_has_topics_for_are_refused():
    with pytest.raises(FlockError, match=r"birds = 20001: must be 20000 or less"):
        FlockConfiguration(birds=20001)
