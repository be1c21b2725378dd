# SPDX-License-Identifier: Apache-2.0
"""The responses of any flock by dense matrices, against the Jacobian and against the chain."""

import numpy as np
import pytest

from flock_sim.response import dense
from flock_sim.response.chain import Chain
from flock_sim.response.dense import Dense
from support.linear_flocks import dense_response, mixed_flock, motion_of, responses

OMEGA = np.array([3e-4, 0.00283, 0.0101, 0.0219, 0.1])


@pytest.mark.parametrize(("lag", "model"), [(0.0, "linear"), (20.0, "linear"), (20.0, "hold")])
@pytest.mark.parametrize("birds", [3, 4, 9])
def test_responses_of_all_to_all_coupling(birds, lag, model):
    flock = mixed_flock(birds, "all")
    found = responses(flock, lag, model)
    assert isinstance(found, Dense)
    for k, response in enumerate(found.responses(OMEGA)):
        expected = dense_response(flock, OMEGA[k], lag, model)
        error = np.abs(response - expected).max(axis=1) / np.abs(expected).max(axis=1)
        assert error.max() < 1e-10


@pytest.mark.parametrize(("lag", "model"), [(0.0, "linear"), (20.0, "linear"), (20.0, "hold")])
@pytest.mark.parametrize("birds", [2, 5, 8])
def test_a_chain_has_the_same_curves(birds, lag, model, monkeypatch):
    monkeypatch.setattr(dense, "BLOCK", 2 * birds**2)  # two frequencies at once
    motion = motion_of(mixed_flock(birds), lag, model)
    one, other = Chain(motion), Dense(motion)
    for name in ("followings", "from_leader", "largest_gains"):
        for found, expected in zip(getattr(one, name)(OMEGA), getattr(other, name)(OMEGA)):
            # At 0.1, far birds hardly move: dense matrices give that to 1e-16 of the largest speed.
            np.testing.assert_allclose(found[:-1], expected[:-1], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(one.densities(OMEGA), other.densities(OMEGA), rtol=1e-10)
    factors, slopes = one.logarithms(OMEGA)
    values, their_slopes = other.logarithms(OMEGA)
    for columns, column in ((one.free, 0), (one.held, 1)):
        product, expected = np.exp(factors[:, columns].sum(axis=1)), np.exp(values[:, column])
        np.testing.assert_allclose(product, expected, rtol=1e-10)
        np.testing.assert_allclose(
            slopes[:, columns].sum(axis=1), their_slopes[:, column], rtol=1e-8, atol=1e-8
        )
