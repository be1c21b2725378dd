# SPDX-License-Identifier: Apache-2.0
"""The stationary variances of a flock in gusts: an independent white acceleration of each bird.

With dU_j = STD dW_j, where W_j are independent Wiener processes, the variance of a quantity with
the responses H_j(omega) to accelerations of single birds is

    STD^2 / pi  integral from 0 to infinity of  sum_j |H_j(omega)|^2  d omega.

Gaps and speeds are stationary; the position of the whole flock is not, and does not occur. The
integral is computed by Gauss's rule between the frequencies of `Frequencies`, from which the poles
are about as far away as the next frequency. Above the highest frequency, omega = top / u maps the
rest to 0 < u < 1. Without a lag, the covariance matrix X of the state is also the solution of
Lyapunov's equation A X + X A^T = -B B^T, which costs O(birds^3).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from flock_sim.errors import RunFailed
from flock_sim.physics.arrays import FloatArray
from flock_sim.theory.delayed.linearisation import DelayedLinearisation

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)

ACCURATE = 1e-7
"""Largest change of an integral by the last halving of an interval, relative to the whole integral.

The error of a rule of 2 n = 16th order then falls by another factor of about 2^-16.
"""

MOST_HALVINGS = 30
MOST_INTERVALS = 100_000


def variances_by_frequency(
    densities: Callable[[FloatArray], FloatArray], omega: FloatArray
) -> FloatArray:
    """Return the integrals of `densities` over all omega > 0, over pi, shape (quantities,).

    `densities` maps frequencies to an array (frequencies, quantities); `omega` are the ascending
    frequencies from 0 of `Frequencies`. Raises RunFailed if the integrals do not converge.
    """
    top = omega[-1]

    def whole(place: FloatArray) -> FloatArray:
        """Return the densities by `place`: omega / top up to 1, and 2 - top / omega beyond."""
        inverse = np.where(place > 1.0, 2.0 - place, 1.0)
        at = np.where(place > 1.0, top / inverse, top * place)
        weighted: FloatArray = densities(at) * (top / inverse**2)[:, np.newaxis]
        return weighted

    ends = np.append(omega / top, 2.0)
    low, high = ends[:-1], ends[1:]
    rough = _gauss(whole, low, high)
    total = rough.sum(axis=0)
    done = np.zeros_like(total)
    for _ in range(MOST_HALVINGS):
        middle = 0.5 * (low + high)
        first, second = _gauss(whole, low, middle), _gauss(whole, middle, high)
        change = np.abs(first + second - rough)
        total += (first + second - rough).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            wide = (change > ACCURATE * total).any(axis=1)
        done += (first + second)[~wide].sum(axis=0)
        if not wide.any():
            return np.asarray(done / np.pi)
        low, high = (
            np.concatenate([low[wide], middle[wide]]),
            np.concatenate([middle[wide], high[wide]]),
        )
        rough = np.concatenate([first[wide], second[wide]])
        if len(low) > MOST_INTERVALS:
            break
    raise RunFailed("the variances in gusts do not converge: the flock hardly damps disturbances")


def variances_by_covariance(motion: DelayedLinearisation) -> FloatArray:
    """Return the same variances without a lag, by Lyapunov's equation: gaps, speeds, mean speed."""
    birds = len(motion.damping)
    gaps = birds - 1
    # Gaps in a unit in which they move as far as speeds, which makes the numbers alike.
    scale = np.append(np.full(gaps, motion.most_rapid), np.ones(birds))
    matrix = scale[:, np.newaxis] * motion.generator(0) / scale
    noise = np.diag(np.append(np.zeros(gaps), np.ones(birds)))
    covariance = solve_continuous_lyapunov(matrix, -noise)
    of_mean = covariance[gaps:, gaps:].mean()
    return np.append(np.diag(covariance) / scale**2, of_mean)


def _gauss(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return Gauss's rule of `function` on all intervals, shape (intervals, quantities)."""
    half = 0.5 * (high - low)
    places = (0.5 * (low + high))[:, np.newaxis] + half[:, np.newaxis] * NODES
    values = function(places.ravel()).reshape(len(low), len(NODES), -1)
    return np.asarray(half[:, np.newaxis] * np.einsum("k,ikq->iq", WEIGHTS, values))
