# SPDX-License-Identifier: Apache-2.0
"""The responses of a chain against dense matrices, and their slopes against differences."""

import numpy as np
import pytest

from flock_sim.physics import formation
from flock_sim.response.chain import Chain
from flock_sim.response.elimination import SHORT, moved_meanwhile
from support.linear_flocks import dense_response, mixed_flock, motion_of, responses

OMEGA = [1e-5, 3e-4, 0.00283, 0.0101, 0.0219, 0.3]
LAGS = [(0.0, "linear"), (20.0, "linear"), (20.0, "hold"), (3.0, "hold")]


@pytest.mark.parametrize(("lag", "model"), LAGS)
@pytest.mark.parametrize("birds", [1, 2, 3, 4, 7, 12])
def test_responses_are_those_of_dense_matrices(birds, lag, model):
    flock = mixed_flock(birds)
    found = responses(flock, lag, model).responses(np.array(OMEGA))
    assert found.shape == (len(OMEGA), 2 * birds - 1, birds)
    for k, omega in enumerate(OMEGA):
        expected = dense_response(flock, omega, lag, model)
        # Delta is almost singular at 1e-5, where its smallest entries matter: 1e-16 / 1e-8.
        error = np.abs(found[k] - expected).max(axis=1) / np.abs(expected).max(axis=1)
        assert error.max() < (1e-7 if omega < 1e-4 else 1e-10)


def test_the_static_response_is_that_of_the_state_space():
    flock = mixed_flock(9)
    found = responses(flock).responses(np.zeros(1))[0]
    np.testing.assert_allclose(found, dense_response(flock, 0.0), rtol=1e-10, atol=1e-8)


@pytest.mark.parametrize(("lag", "model"), LAGS)
@pytest.mark.parametrize("birds", [2, 3, 6, 11])
def test_all_curves_follow_from_the_responses(birds, lag, model):
    flock = mixed_flock(birds)
    chain = responses(flock, lag, model)
    omega = np.array(OMEGA)
    response = chain.responses(omega)
    speeds, gaps = response[:, :birds], response[:, birds:]
    head = formation.leader(birds) - 1
    # If the leader alone is accelerated, the others follow its speed, whatever keeps it.
    expected = np.abs(speeds[:, :, head] / speeds[:, [head], head])
    np.testing.assert_allclose(np.exp(chain.followings(omega)[0]), expected, rtol=1e-12)
    expected = np.linalg.norm(gaps[:, :, head], axis=1)
    np.testing.assert_allclose(np.exp(chain.from_leader(omega)[0]), expected, rtol=1e-12)
    expected = np.linalg.svd(gaps, compute_uv=False)[:, 0]
    np.testing.assert_allclose(np.exp(chain.largest_gains(omega)[0]), expected, rtol=1e-12)
    squares = [gaps, speeds, speeds.mean(axis=1, keepdims=True)]
    expected = np.concatenate([(np.abs(part) ** 2).sum(axis=2) for part in squares], axis=1)
    np.testing.assert_allclose(chain.densities(omega), expected, rtol=1e-11)


def test_largest_gains_of_a_long_chain_are_singular_values():
    # More birds than Lanczos vectors: the method begins again.
    chain = responses(mixed_flock(130, spread=1e-5))
    omega = np.array([0.0, 1e-4, 0.002, 0.02])
    gaps = chain.responses(omega)[:, 130:]
    expected = np.linalg.svd(gaps, compute_uv=False)[:, 0]
    np.testing.assert_allclose(np.exp(chain.largest_gains(omega)[0]), expected, rtol=1e-11)


def test_largest_gains_of_late_birds_whose_leader_is_not_in_front():
    # Bird 43 of 51 flies in front of these late birds, and each hardly sees those behind it.
    chain = responses(mixed_flock(51, spread=3e-4), 20.0, "hold")
    omega = np.array([0.0, 1e-6, 1e-4, 0.002, 0.02])
    gaps = chain.responses(omega)[:, 51:]
    expected = np.linalg.svd(gaps, compute_uv=False)[:, 0]
    np.testing.assert_allclose(np.exp(chain.largest_gains(omega)[0]), expected, rtol=1e-9)


@pytest.mark.parametrize(("lag", "model"), LAGS)
def test_slopes_are_derivatives(lag, model):
    chain = responses(mixed_flock(8), lag, model)
    omega = np.array([0.0021, 0.0103, 0.017])
    step = 1e-6 * omega  # error of the central difference: (step / 1e-3)^2 and 1e-16 / 1e-6
    for curve in (chain.followings, chain.from_leader, chain.largest_gains, chain.logarithms):
        slopes = curve(omega)[1]
        difference = curve(omega + step)[0] - curve(omega - step)[0]
        if np.iscomplexobj(slopes):
            slopes = 1j * slopes  # by omega
        width = (2.0 * step).reshape(-1, *[1] * (slopes.ndim - 1))
        np.testing.assert_allclose(slopes, difference / width, rtol=1e-6, atol=1e-5)


def test_the_factors_multiply_to_the_determinant():
    motion = motion_of(mixed_flock(6), 20.0, "hold")
    chain = Chain(motion)
    omega = np.array([1e-4, 3e-3, 0.02])
    logarithms = chain.logarithms(omega)[0]
    led = [0, 1, 2, 4, 5]  # bird 4 leads
    assert chain.held == led
    for k, at in enumerate(omega):
        root = 1j * at
        shifted = root + chain.scale
        delta = motion.characteristic(root)
        expected = np.linalg.det(delta) / root / shifted**11
        assert np.exp(logarithms[k].sum()) == pytest.approx(expected, rel=1e-9)
        expected = np.linalg.det(delta[np.ix_(led, led)]) / shifted**10
        assert np.exp(logarithms[k][led].sum()) == pytest.approx(expected, rel=1e-9)


def test_the_way_in_a_lag_has_no_seam():
    for root in (0.99j * SHORT / 20.0, 1.01j * SHORT / 20.0):
        value, slope = moved_meanwhile(root, 20.0)
        assert value == pytest.approx((1.0 - np.exp(-20.0 * root)) / root, rel=1e-13)
        expected = 20.0 * np.exp(-20.0 * root) / root - (1.0 - np.exp(-20.0 * root)) / root**2
        assert slope == pytest.approx(expected, rel=1e-10)
    assert moved_meanwhile(0j, 20.0) == (20.0, -200.0)
    assert moved_meanwhile(1j, 0.0) == (0.0, 0.0)
