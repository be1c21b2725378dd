# SPDX-License-Identifier: Apache-2.0
"""The responses of ensembles: members with and without a steady state, one and two birds."""

import numpy as np
import pytest

from flock_sim.response.linear_response import frequency_response, linear_response, neighbour_pairs
from flock_sim.theory.delayed.nearest import delayed_nearest
from flock_sim.theory.equilibrium import equilibrium
from support.linear_flocks import dense_response, mixed_flock, motion_of
from support.steady_states import flock_of


def members(found, m):
    """All values of a member."""
    values = {**vars(found), **vars(found.gust)}
    return {name: value[m] for name, value in values.items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_members_without_a_steady_state_have_no_response(coupling):
    ratios = np.ones((5, 3))
    ratios[1, 1] = 0.6
    ratios[1, 2] = 1.01
    found = linear_response(flock_of(5, ratios, coupling=coupling), gust=1e-5)
    assert found.exists.tolist() == [True, False, True]
    assert found.stable.tolist() == [True, False, True]
    for name, value in members(found, 1).items():
        if name not in ("exists", "stable"):
            assert np.isnan(value).all(), name
    # Every member is what it is alone, to the bit.
    for m in (0, 2):
        alone = members(linear_response(flock_of(5, ratios[:, m], coupling=coupling), gust=1e-5), 0)
        for name, value in members(found, m).items():
            np.testing.assert_array_equal(value, alone[name], err_msg=name)
            finite = coupling == "nearest" or "gibbs" not in name
            assert np.isfinite(value).all() == finite, name


def test_a_bird_alone():
    found = linear_response(flock_of(1), gust=2e-5)
    damping = motion_of(flock_of(1)).damping[0]
    expected = 2e-5 / np.sqrt(2.0 * damping)
    assert found.gust.bird_speed_std[0] == pytest.approx([expected], rel=1e-12)
    assert found.gust.mean_speed_std[0] == pytest.approx(expected, rel=1e-12)
    assert found.gust.speed_spread_rms.tolist() == [0.0]
    assert found.speed_gain_peak.tolist() == [[1.0]]
    assert found.hinf_gaps.tolist() == found.hinf_gaps_from_leader.tolist() == [0.0]
    assert found.neighbour_gain_peak.shape == found.gust.gap_std.shape == (1, 0)


def test_two_birds_by_hand():
    # Side by side, both save the same drag, so the gap is driven by the difference of accelerations
    # and damped by the drag of solo flight: g'' = -q g' - k g + (a_2 - a_1).
    motion = motion_of(flock_of(2))
    stiffness = 2.0 * motion.pull[0, 1]
    damping = motion.damping[0] + motion.push[0, 1]
    found = linear_response(flock_of(2), gust=1e-5)
    peak = np.sqrt(2.0) / (damping * np.sqrt(stiffness - 0.25 * damping**2))
    assert found.hinf_gaps[0] == pytest.approx(peak, rel=1e-12)
    at = np.sqrt(stiffness - 0.5 * damping**2)
    assert found.hinf_gaps_frequency[0] == pytest.approx(at, rel=1e-12)
    assert found.hinf_gaps_from_leader[0] == pytest.approx(peak / np.sqrt(2.0), rel=1e-12)
    variance = 2e-10 / (2.0 * damping * stiffness)
    assert found.gust.gap_std[0, 0] == pytest.approx(np.sqrt(variance), rel=1e-12)
    common = motion.damping[0] - motion.push[0, 1]
    assert found.gust.mean_speed_std[0] == pytest.approx(1e-5 / np.sqrt(4.0 * common), rel=1e-12)
    spread = 1e-10 / (4.0 * damping)  # (u_2 - u_1)^2 / 4
    assert found.gust.speed_spread_rms[0] == pytest.approx(np.sqrt(spread), rel=1e-12)


def test_a_flock_that_shakes_itself_apart_has_no_response():
    # Three geese that extrapolate over a lag of more than 41.8 lose stability.
    found = linear_response(flock_of(3), lag=43.0, model="linear", gust=1e-5)
    assert found.exists.tolist() == [True]
    assert found.stable.tolist() == [False]
    assert np.isnan(found.hinf_gaps).all()
    assert np.isnan(found.gust.gap_std).all()
    assert linear_response(flock_of(3), lag=41.0, model="linear").stable.tolist() == [True]


def test_the_spread_is_that_of_the_metrics():
    # <sigma_U^2> = <(1/N) sum_j (u_j - u)^2> from the covariances of all speeds.
    flock = mixed_flock(5)
    omega = np.linspace(0.0, 0.2, 200001)[1:]
    state = equilibrium(flock)
    speeds = frequency_response(flock, state, omega)[:, :5]
    apart = speeds - speeds.mean(axis=1, keepdims=True)
    density = (np.abs(apart) ** 2).sum(axis=2).mean(axis=1)
    # Beyond 0.2 a bird moves by its own acceleration only: the density is (4 / 5) / omega^2.
    integral = np.trapezoid(density, omega) + 0.8 / 0.2
    found = linear_response(flock, gust=1e-5).gust.speed_spread_rms[0]
    assert found == pytest.approx(1e-5 * np.sqrt(integral / np.pi), rel=1e-4)


@pytest.mark.parametrize(("lag", "model"), [(0.0, "linear"), (20.0, "hold")])
def test_the_frequency_response_of_a_member(lag, model):
    ratios = np.ones((4, 2))
    ratios[1, 1] = 1.005
    flock = flock_of(4, ratios)
    state = delayed_nearest(flock, lag) if lag else equilibrium(flock)
    found = frequency_response(flock, state, 0.004, lag=lag, model=model, member=1)
    assert found.shape == (1, 7, 4)
    expected = dense_response(flock_of(4, ratios[:, 1]), 0.004, lag, model)
    np.testing.assert_allclose(found[0], expected, rtol=1e-8, atol=1e-6)


def test_neighbours_nearer_to_the_leader():
    outer, inner = neighbour_pairs(5)
    assert outer.tolist() == [0, 1, 3, 4]
    assert inner.tolist() == [1, 2, 2, 3]
    outer, inner = neighbour_pairs(4)  # bird 3 leads
    assert outer.tolist() == [0, 1, 3]
    assert inner.tolist() == [1, 2, 2]


def test_mirrored_flocks_have_mirrored_responses():
    ratios = mixed_flock(7).span_ratio[:, 0]
    one = linear_response(flock_of(7, ratios), gust=1e-5)
    other = linear_response(flock_of(7, ratios[::-1]), gust=1e-5)
    np.testing.assert_allclose(one.hinf_gaps, other.hinf_gaps, rtol=1e-10)
    for name in ("speed_gain_peak", "speed_gain_frequency", "neighbour_gain_peak"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name)[:, ::-1], rtol=1e-9)
    np.testing.assert_allclose(one.gust.gap_std, other.gust.gap_std[:, ::-1], rtol=1e-10)


@pytest.mark.parametrize("bad", [{"lag": -1.0}, {"lag": np.nan}, {"lag": 1.0, "model": "exact"}])
def test_bad_lags_are_refused(bad):
    with pytest.raises(ValueError, match="must be"):
        linear_response(flock_of(3), **bad)
