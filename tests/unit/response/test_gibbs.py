# SPDX-License-Identifier: Apache-2.0
"""The distribution of gaps against quadrature of the paper's integral, and against flights."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from flock_sim.physics.stage_kernels import (
    CIRCULATION,
    DISTANCE,
    ON_BIRD,
    ON_OTHER,
    OTHER_CIRCULATION,
    compute_drags,
)
from flock_sim.response.gibbs import gap_distributions
from flock_sim.response.linear_response import linear_response
from flock_sim.theory.equilibrium import equilibrium
from support.linear_flocks import mixed_flock
from support.steady_flocks import TIP, A, integral, positions_of

RATIOS = [1.002, 0.998, 1.004, 1.0]


def expected_moments(spacing, one, other, std):
    """Mean and standard deviation of exp(-Phi / T), Phi by the integral I of the paper."""
    lateral = one + other + TIP

    def share(x):
        return integral(x, lateral, A * one, A * other) if x else 0.5 * pair

    pair = 2.0 * integral(1e-9, lateral, A * one, A * other)
    step = 1e-4
    slope = (share(spacing + step) - share(spacing - step)) / (2.0 * step)

    def potential(x):
        """Phi over its second derivative at the steady gap."""
        points = [0.0] if min(x, spacing) < 0.0 < max(x, spacing) else None
        return quad(
            lambda y: (share(y) - share(spacing)) / slope, spacing, x, points=points, epsabs=1e-12
        )[0]

    reach = 14.0 * std + 6.0 * std**2
    x, weight = np.polynomial.legendre.leggauss(400)
    places = spacing + reach * x
    density = np.array([weight[k] * np.exp(-potential(p) / std**2) for k, p in enumerate(places)])
    mean = (density * places).sum() / density.sum()
    return mean, np.sqrt((density * (places - mean) ** 2).sum() / density.sum())


@pytest.mark.parametrize("std", [0.01, 0.2, 0.7])
def test_moments_are_those_of_the_potential(std):
    flock = mixed_flock(4)
    spacing = equilibrium(flock).spacing[:, 0]
    found = gap_distributions(flock, spacing, np.full(3, std))
    ratios = flock.span_ratio[:, 0]
    for k in range(3):
        mean, deviation = expected_moments(spacing[k], ratios[k], ratios[k + 1], std)
        # The slope at the steady gap is a difference, to (1e-4)^2.
        assert found[0, k] == pytest.approx(mean, rel=1e-6)
        assert found[1, k] == pytest.approx(deviation, rel=1e-6)


def test_weak_gusts_are_linear():
    flock = mixed_flock(6)
    spacing = equilibrium(flock).spacing[:, 0]
    for std in (1e-3, 1e-6, 1e-12):
        mean, deviation = gap_distributions(flock, spacing, np.full(5, std))
        # the next terms are of relative order (std / 0.2)^2
        np.testing.assert_allclose(deviation, std, rtol=max(100.0 * std**2, 1e-12))
        assert np.all(np.abs(mean - spacing) <= 20.0 * std**2)


def test_no_gust_and_no_number():
    flock = mixed_flock(3)
    spacing = equilibrium(flock).spacing[:, 0]
    found = gap_distributions(flock, spacing, np.array([0.0, np.nan]))
    assert found[:, 0].tolist() == [spacing[0], 0.0]
    assert np.isnan(found[:, 1]).all()


def test_strong_gusts_end_in_exponential_tails():
    # A gap of two equal birds, far from 0: |Phi'| is the same on both sides, so p is that of
    # Laplace with the decay length L = T / |Phi'|, and its standard deviation is sqrt(2) L.
    flock = mixed_flock(2, spread=1e-12)
    spacing = equilibrium(flock).spacing[:, 0]
    std = 300.0
    deviation = gap_distributions(flock, spacing, np.array([std]))[1, 0]
    lateral = 2.0 + TIP
    pair = 2.0 * integral(1e-9, lateral, A, A)
    step = 1e-4
    slope = (integral(step, lateral, A, A) - integral(-step, lateral, A, A)) / (2.0 * step)
    length = std**2 * abs(slope) / abs(0.5 * pair)
    assert deviation == pytest.approx(np.sqrt(2.0) * length, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("std", [2e-5, 2e-4, 5e-4])
def test_the_estimate_is_that_of_nonlinear_flights(std):
    # The equations of motion with white accelerations, 96 flocks of 5 birds. Speeds correlate over
    # 1 / 1.3e-3, and gaps over as long, so that a standard deviation is known to some
    # 0.7 / sqrt(96 * 40000 / 1500), 1.4 %. The linear theory is 12 % off for 2e-4 (gap 1).
    flock = mixed_flock(5, spread=1e-9)
    members, dt, steps, skipped = 96, 4.0, 11000, 1000
    state = equilibrium(flock)
    many = replace(flock, span_ratio=np.repeat(flock.span_ratio, members, axis=1))
    mass, thrust, profile, induced, circulation = many.coefficients.swapaxes(0, 1)
    interactions = many.interactions(many.pairs)
    pairs = interactions[:, : 4 * members].reshape(-1, 4, members)

    def slope(x, u):
        pairs[DISTANCE] = np.diff(x, axis=0)
        pairs[CIRCULATION] = (circulation / u)[:-1]
        pairs[OTHER_CIRCULATION] = (circulation / u)[1:]
        compute_drags(interactions)
        drag = np.pad(pairs[ON_BIRD], ((0, 1), (0, 0))) + np.pad(pairs[ON_OTHER], ((1, 0), (0, 0)))
        return (thrust - profile * u**2 - induced / u**2 - drag) / mass

    random = np.random.default_rng(1)
    x = np.repeat(positions_of(state.spacing[:, 0])[:, np.newaxis], members, axis=1)
    u = np.full_like(x, state.speed[0])
    gaps = []
    for step in range(steps):
        u = u + std * np.sqrt(dt) * random.standard_normal(u.shape)
        a1 = slope(x, u)
        a2 = slope(x + 0.5 * dt * u, u + 0.5 * dt * a1)
        a3 = slope(x + 0.5 * dt * (u + 0.5 * dt * a1), u + 0.5 * dt * a2)
        a4 = slope(x + dt * (u + 0.5 * dt * a2), u + dt * a3)
        x = x + dt * (u + dt / 6.0 * (a1 + a2 + a3))
        u = u + dt / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        if step >= skipped and step % 20 == 0:
            gaps.append(np.diff(x, axis=0))
    flown = np.concatenate(gaps, axis=1).std(axis=1)
    flown = 0.5 * (flown + flown[::-1])  # the flock is its own mirror image
    found = linear_response(flock, gust=std).gust
    np.testing.assert_allclose(found.gap_std_gibbs[0], flown, rtol=0.05)
    if std > 1e-4:
        assert np.all(found.gap_std[0] < 0.9 * flown)
