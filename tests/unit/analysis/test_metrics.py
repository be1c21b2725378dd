# SPDX-License-Identifier: Apache-2.0
"""The metrics agree with an independent computation of the paper's metrics."""

import json
from fractions import Fraction
from math import inf, log, nan, pi

import mpmath
import numpy as np
import pytest
from scipy.optimize import brentq

from flock_sim.analysis import metrics as core_metrics
from flock_sim.analysis.metrics import Metrics, mean_over_birds, measure, speed_std
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock_state import FlockState

K = 2.0 * 0.025 / 9.0  # Eq. (hatk)
CRUISE = 18.5 / 18.0
STANDARD_DRAG = K * (CRUISE**2 + CRUISE**-2)  # Eq. (hatD) at U_0
A = pi / 4.0
GAP = 1.0 + A  # 2 b + s_opt


def measured(configuration: FlockConfiguration, position=None, speed=None, drag=None) -> Metrics:
    """The metrics of a flock whose arrays are given, of shape (birds, members) or (birds,)."""
    shape = (configuration.birds, configuration.members)
    arrays = [
        np.full(shape, default)
        if given is None
        else np.array(given, dtype=float).reshape(shape[0], -1) * np.ones(shape)
        for given, default in ((position, 0.0), (speed, CRUISE), (None, 0.0), (drag, 0.0))
    ]
    means = arrays[1], arrays[3]
    return measure(configuration, FlockState(10, configuration.time(10), *arrays, *means))


def integral(x: float) -> float:
    """I(x) of two standard neighbours, by the closed form that the paper prints, in 50 digits."""
    with mpmath.workdps(50):
        x, y, a = mpmath.mpf(x), mpmath.mpf(GAP), mpmath.mpf(A)

        def j(u):
            return mpmath.sqrt(x * x + u * u)

        def k(u):
            return x / (2 * abs(x)) * mpmath.log((j(u) - abs(x)) / (j(u) + abs(x)))

        bound = (j(y + 2 * a) + j(y - 2 * a) - 2 * j(y)) / x
        right = mpmath.log((y + 2 * a) / y) + k(y + 2 * a) - k(y)
        left = mpmath.log(y / (y - 2 * a)) + k(y) - k(y - 2 * a)
        return float(bound + right - left)


# C = Gamma^2 / (2 pi) ln[1 - (2 a / dy)^2] and D = Gamma^2 / (4 pi) I: their ratio has no Gamma.
def share(x: float) -> float:
    """D_{i,i-1} / C where x = x_i - x_{i-1}. Eqs. (Djk2), (pairingC_x)."""
    return integral(x) / (2.0 * log(1.0 - (2.0 * A / GAP) ** 2))


def linear_profile(birds: int) -> np.ndarray:
    """Positions from tail to tail that obey Eq. (linear_general_x)."""
    wing = [
        brentq(lambda x, i=i: share(x) - (1.0 - i / birds), 1e-9, 50.0, xtol=1e-15)
        for i in range(1, birds // 2 + 1)
    ]
    left = np.concatenate([[0.0], np.cumsum(wing)])
    return np.concatenate([left, left[-2::-1]])


def test_sigma_is_the_root_of_mean_square_less_squared_mean() -> None:
    speed = [1.25, 1.375, 1.5, 1.25, 1.125]
    exact = [Fraction(value) for value in speed]
    mean = sum(exact) / 5
    variance = sum(value**2 for value in exact) / 5 - mean**2
    metrics = measured(FlockConfiguration(birds=5), speed=speed)
    assert metrics.mean_speed[0] == pytest.approx(float(mean), rel=1e-15)
    assert metrics.speed_std[0] == pytest.approx(float(variance) ** 0.5, rel=1e-14)


@pytest.mark.parametrize("spread", [1e-5, 0.999e-4, 1.001e-4, 1e-3])
def test_a_flock_is_stable_below_the_papers_threshold(spread: float) -> None:
    # Two birds at mean +- d have sigma_U = d.
    metrics = measured(FlockConfiguration(birds=2), speed=[1.2 - spread, 1.2 + spread])
    assert metrics.stable == [spread < 1e-4]


def test_a_spread_far_below_the_rounding_of_squares_is_measured() -> None:
    metrics = measured(FlockConfiguration(birds=2), speed=[1.0, 1.0 + 2.0**-40])
    assert metrics.speed_std[0] == 2.0**-41


@pytest.mark.parametrize("birds", [1, 8, 13, 200])
def test_means_add_birds_in_order_whatever_the_number_of_members(birds: int) -> None:
    # NumPy adds a single column in another order than several, to another last bit.
    speed = np.random.default_rng(birds).uniform(0.9, 1.1, (birds, 64))
    alone = [speed_std(speed[:, [m]])[0] for m in range(64)]
    assert speed_std(speed).tolist() == alone
    for m, mean in enumerate(mean_over_birds(speed)):
        total = 0.0
        for value in speed[:, m].tolist():
            total += value
        assert mean == total / birds
        assert mean == mean_over_birds(speed[:, m])


def test_drag_reduction_is_in_units_of_the_standard_bird_at_cruise() -> None:
    drag = np.array([-0.001, -0.002, 0.0005])
    configuration = FlockConfiguration(birds=3, span_ratios=("1=1.2",))
    metrics = measured(configuration, drag=drag)
    assert metrics.drag_reduction[0] == pytest.approx(-drag / STANDARD_DRAG, rel=1e-14)
    assert metrics.mean_drag_reduction[0] == pytest.approx(0.0025 / 3.0 / STANDARD_DRAG, rel=1e-14)


@pytest.mark.parametrize("birds", [3, 7, 13])
def test_a_linear_profile_is_recognised(birds: int) -> None:
    configuration = FlockConfiguration(birds=birds)
    position = linear_profile(birds)
    # Rounding of positions of some b, by slopes of D/C of order 1 / b; brentq stops at 4 eps.
    assert measured(configuration, position).profile_error[0] < 1e-13
    wing = np.diff(position)[: birds // 2]
    moved = position.copy()
    moved[0] -= 0.25
    expected = abs(share(wing[0] + 0.25) - (1.0 - 1.0 / birds))
    assert measured(configuration, moved).profile_error[0] == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize(
    "parameters",
    [
        {"birds": 6},
        {"birds": 1},
        {"birds": 7, "coupling": "all"},
        {"birds": 7, "span_ratios": ("2=1.01",)},
    ],
)
def test_a_profile_is_not_judged_where_the_law_does_not_hold(parameters: dict) -> None:
    assert measured(FlockConfiguration(**parameters)).profile_error == [None]


def test_each_member_has_a_profile_of_its_own() -> None:
    configuration = FlockConfiguration(birds=3, span_ratios=("2=1.0,1.1",))
    metrics = measured(configuration, linear_profile(3))
    assert metrics.profile_error[0] == pytest.approx(0.0, abs=1e-13)
    assert metrics.profile_error[1] is None


@pytest.mark.parametrize(
    ("position", "falls"),
    [
        ([0.0, 3.0, 5.0, 6.0, 5.0, 3.0, 0.0], True),
        ([0.0, 3.0, 5.0, 6.0, 9.0, 9.0, 9.0], True),  # only the left wing counts
        ([0.0, 2.0, 4.0, 5.0, 4.0, 2.0, 0.0], False),  # strictly
        ([0.0, 1.0, 3.0, 6.0, 3.0, 1.0, 0.0], False),
        ([nan, 3.0, 5.0, 6.0, 5.0, 3.0, 0.0], False),
        ([-inf, 3.0, 5.0, 6.0, 5.0, 3.0, 0.0], False),
    ],
)
def test_a_hierarchy_is_a_spacing_that_falls_from_tail_to_leader(position, falls: bool) -> None:
    assert measured(FlockConfiguration(birds=7), position).hierarchical == [falls]


@pytest.mark.parametrize("birds", [1, 2, 3, 4, 13])
def test_geometry_is_relative_to_the_leader(birds: int) -> None:
    position = 1000.0 + np.arange(birds) ** 2.0
    metrics = measured(FlockConfiguration(birds=birds), position)
    assert metrics.leader == birds // 2 + 1
    assert metrics.position[0][metrics.leader - 1] == 0.0
    assert metrics.lateral[0][metrics.leader - 1] == 0.0
    np.testing.assert_array_equal(metrics.position[0], position - position[birds // 2])
    np.testing.assert_array_equal(metrics.spacing[0], position[1:] - position[:-1])
    np.testing.assert_allclose(np.diff(metrics.lateral[0]), GAP, rtol=1e-14)


def test_a_bird_alone_saves_nothing_and_is_stable() -> None:
    metrics = measured(FlockConfiguration(birds=1))
    assert metrics.spacing.shape == (1, 0)
    assert metrics.speed_std[0] == 0.0
    assert metrics.stable == [True]
    assert not np.signbit(metrics.drag_reduction).any()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [nan, inf, -inf])
@pytest.mark.parametrize("name", ["position", "speed", "drag"])
def test_a_member_that_is_not_finite_disturbs_no_other_and_no_warning_shows(
    name: str, value: float
) -> None:
    configuration = FlockConfiguration(birds=3, span_ratios=("2=1,1,1",))
    values = {
        "position": np.repeat(linear_profile(3)[:, np.newaxis], 3, axis=1),
        "speed": np.full((3, 3), 1.2),
        "drag": np.full((3, 3), -0.001),
    }
    whole = measured(configuration, **values).as_json()
    values[name] = values[name].copy()
    values[name][0, 1] = value
    broken = measured(configuration, **values)
    for key, entries in broken.as_json().items():
        if isinstance(entries, list):
            assert [entries[0], entries[2]] == [whole[key][0], whole[key][2]]
    assert broken.stable[1] == (name == "drag")
    json.dumps(broken.as_json(), allow_nan=False)


def test_the_threshold_is_the_papers() -> None:
    assert core_metrics.STABLE_BELOW == 1e-4
