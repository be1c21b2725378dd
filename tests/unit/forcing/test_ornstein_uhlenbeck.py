# SPDX-License-Identifier: Apache-2.0
"""The exact discretisation of an Ornstein-Uhlenbeck process against integrals and composition."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from flock_sim.forcing.ornstein_uhlenbeck import coefficients

DIGITS = 60
RATIOS = [10.0**power for power in range(-12, 13)]
"""tau / dt."""


def moments(std: float, time: float, dt: float) -> tuple[mpmath.mpf, ...]:
    """Return decay, E mean / a, var a', var mean and cov(a', mean), by integrals over the noise.

    a' = e a + b int e^{-(dt - s)/tau} dW, and the integral of a over the step is
    tau (1 - e) a + b tau int (1 - e^{-(dt - s)/tau}) dW, with b^2 = 2 std^2 / tau. The integrals
    over s are written with expm1, so that nothing cancels but in the last one.
    """
    s, tau, step = mpmath.mpf(std), mpmath.mpf(time), mpmath.mpf(dt)
    d = step / tau
    b2 = 2 * s * s / tau
    once, twice = -mpmath.expm1(-d), -mpmath.expm1(-2 * d)
    end = b2 * tau / 2 * twice
    together = b2 * tau * (tau * once - tau / 2 * twice)
    mean = b2 * tau**2 * (step - 2 * tau * once + tau / 2 * twice)
    return mpmath.exp(-d), tau * once / step, end, mean / step**2, together / step


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("dt", [1.0, 0.3])
def test_the_coefficients_give_the_moments_of_the_process(ratio: float, dt: float) -> None:
    std, time = 0.7, ratio * dt
    found = coefficients(std, time, dt)
    # Digits cancel in var mean: of the order of d^3, by terms of the order of d.
    with mpmath.workdps(DIGITS + 40):
        decay, drift, end, mean, together = moments(std, time, dt)
        first = mpmath.sqrt(end)
        second = together / first
        expected = (
            (decay - 1) / dt,
            first / mpmath.mpf(dt),
            drift,
            second,
            mpmath.sqrt(mean - second * second),
        )
        for value, exact in zip(found, expected, strict=True):
            # Each is rounded once.
            assert abs(mpmath.mpf(value) - exact) <= abs(exact) * mpmath.mpf(2) ** -53


@pytest.mark.parametrize("ratio", [1e-12, 1e-3, 0.5, 1.0, 7.0, 1e4, 1e12])
def test_two_half_steps_are_one_step_in_distribution(ratio: float) -> None:
    """End and mean of a step, composed of two half steps, have the covariances of one step."""
    with mpmath.workdps(DIGITS):
        one, half = ([mpmath.mpf(c) for c in coefficients(1.0, ratio, dt)] for dt in (1.0, 0.5))
        e = 1 + half[0] / 2
        # Rows: end and mean; columns: a, xi and zeta of the first half, xi and zeta of the second.
        middle = [e, half[1] / 2, 0, 0, 0]
        end = [*(e * value for value in middle[:3]), half[1] / 2, 0]
        first = [half[2], half[3], half[4], 0, 0]
        second = [*(half[2] * value for value in middle[:3]), half[3], half[4]]
        mean = [(x + y) / 2 for x, y in zip(first, second)]

        def covariance(x: list[mpmath.mpf], y: list[mpmath.mpf]) -> mpmath.mpf:
            return mpmath.fsum(p * q for p, q in zip(x, y))

        whole_end, whole_mean = [1 + one[0], one[1], 0], [one[2], one[3], one[4]]
        for composed, single in (
            ((end[:1], end[:1]), (whole_end[:1], whole_end[:1])),
            ((mean[:1], mean[:1]), (whole_mean[:1], whole_mean[:1])),
            ((end[1:], end[1:]), (whole_end[1:], whole_end[1:])),
            ((mean[1:], mean[1:]), (whole_mean[1:], whole_mean[1:])),
            ((end[1:], mean[1:]), (whole_end[1:], whole_mean[1:])),
        ):
            # Coefficients are rounded to doubles: some ten roundings of the largest term.
            exact = covariance(*single)
            assert abs(covariance(*composed) - exact) <= abs(exact) * 2.0**-48 + 1e-40


def test_the_process_is_stationary() -> None:
    for ratio in RATIOS:
        decay, noise, *_ = coefficients(0.7, ratio, 1.0)
        with mpmath.workdps(DIGITS):
            variance = (1 + mpmath.mpf(decay)) ** 2 * 0.49 + mpmath.mpf(noise) ** 2
            assert abs(variance - 0.49) < 2.0**-51


def test_a_short_correlation_time_gives_a_white_acceleration() -> None:
    """The mean over a step of dt >> tau is sqrt(2 tau) std xi / sqrt(dt)."""
    *_, drift, together, alone = coefficients(3.0, 1e-10, 1.0)
    assert math.hypot(together, alone) == pytest.approx(3.0 * math.sqrt(2e-10), rel=1e-9)
    assert drift == pytest.approx(1e-10)


def test_a_long_correlation_time_gives_a_constant_acceleration() -> None:
    rate, noise, drift, together, alone = coefficients(1.0, 1e12, 1.0)
    assert drift == pytest.approx(1.0, abs=1e-12)
    assert rate == pytest.approx(-1e-12, rel=1e-11)
    assert noise == pytest.approx(math.sqrt(2e-12), rel=1e-11)
    # The integral of a Wiener process: half of its end, and sqrt(1/12) that is independent of it.
    assert together / noise == pytest.approx(0.5, rel=1e-10)
    assert alone / noise == pytest.approx(math.sqrt(1.0 / 12.0), rel=1e-10)


def test_without_strength_all_but_the_decay_is_zero() -> None:
    rate, noise, drift, together, alone = coefficients(0.0, 2.0, 1.0)
    assert (noise, together, alone) == (0.0, 0.0, 0.0)
    assert rate == pytest.approx(np.expm1(-0.5))
    assert drift == pytest.approx(-2.0 * np.expm1(-0.5))
