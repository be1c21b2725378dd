# SPDX-License-Identifier: Apache-2.0
"""Small motions about steady flight in which birds see each other with a constant lag.

About the steady state a small disturbance x_j, v_j = dx_j/dt of positions and speeds obeys

    dv_j/dt = -(sum_i b_ji) x_j - c_j v_j + sum_i [b_ji X_i + e_ji V_i]
    X_i = x_i(t - tau) + a v_i(t - tau)                  V_i = v_i(t - tau) + a dv_i/dt(t - tau)

    b_ji = -Gamma_i Gamma_j I'(p_ij) / (4 pi m_j) > 0    c_j = (dD_j/dU - sum_i D_ij / U*) / m_j
    e_ji = D_ij / (m_j U*) < 0                           a = 0 (`hold`), tau (`linear`)

where p_ij is the distance by which bird j sees bird i ahead: x_i - x_j - U* tau with `hold`, or
x_i - x_j with `linear`, which extrapolates position and circulation. Disturbances x exp(lambda t)
are solutions if det Delta = 0,

    Delta(lambda) = lambda^2 + lambda c + sum_i b - (1 + a lambda) exp(-lambda tau) (b + lambda e).

A translation of the whole flock changes nothing: Delta(0) (1, ..., 1) = 0. This root is removed:
positions are written as sums of spacings, and their common part as its speed over lambda. The
expression

    Delta(lambda) (1, ..., 1) / lambda = lambda + c - exp(-lambda tau) (e + a b + a lambda e)
                                         + sum_i b (1 - exp(-lambda tau)) / lambda

has no pole at 0, so the reduced determinant has all other roots of Delta, and only them.

With `linear` the acceleration one lag ago has an effect: the equation is of neutral type. As long
as this effect is smaller than that of the present acceleration, sum_i |a e_ji| < 1, it only adds
roots far to the left. For geese this holds up to lags of some thousands.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigvals

from flock_sim.errors import RunFailed
from flock_sim.physics import formation
from flock_sim.physics.aerodynamics import ahead_integral_and_slope, split_drag
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.physics.interaction import PER_FOUR_PI

ComplexArray = npt.NDArray[np.complex128]

HOLD, LINEAR = "hold", "linear"
MODELS = (HOLD, LINEAR)
"""The use of a state that is one lag old: a bird holds it, or extrapolates it at its speed."""

LEAST_NODES = 24
"""Number of Chebyshev points for a history without oscillation: they give exp(lambda theta) to
rounding, and modes that don't matter decay by less."""

MOST_POLISHES = 30

POLISHED = 1e-14
"""Size of the last step of polishing, relative to the bound `most_rapid` on the roots."""

STRAYED = 1e-3
"""Largest shift of a root by polishing, relative to the same bound: otherwise the grid is too
coarse."""


@dataclass(frozen=True)
class DelayedLinearisation:
    """The linear equations of one flock about steady flight, in units of b, U_min and b / U_min."""

    lag: float
    """tau."""
    damping: FloatArray
    """c_j, shape (birds,)."""
    pull: FloatArray
    """b_ji, row j for the affected bird, column i for the bird that it sees, (birds, birds)."""
    push: FloatArray
    """e_ji + a b_ji, the response to seen speeds, shape (birds, birds)."""
    surge: FloatArray
    """a e_ji, the response to seen accelerations, shape (birds, birds)."""

    @classmethod
    def of(
        cls, flock: Flock, spacing: FloatArray, speed: float, lag: float, model: str
    ) -> DelayedLinearisation:
        """Return the equations about a steady state of a flock of one member.

        `spacing` (birds - 1,) in b and `speed` in U_min are those of the steady state at `lag`, in
        b / U_min, for `model`, one of `MODELS`. They are nan if no steady state exists.
        """
        birds = flock.birds
        ratios = flock.coefficients[:, :, 0]
        mass, profile, induced, circulation = ratios[:, 0], ratios[:, 2], ratios[:, 3], ratios[:, 4]
        position = formation.positions(spacing[:, np.newaxis])[:, 0]
        late = speed * lag if model == HOLD else 0.0
        pull, push = np.zeros((birds, birds)), np.zeros((birds, birds))
        for k, (one, other) in enumerate(flock.pairs):
            strength = PER_FOUR_PI * circulation[one] * circulation[other] / speed**2
            even = flock.even[k, 0]
            for i, j in ((one, other), (other, one)):
                seen = position[i] - position[j] - late
                ahead, slope = ahead_integral_and_slope(
                    abs(seen), flock.lateral[k, 0], flock.half_span[i, 0], flock.half_span[j, 0]
                )
                drag = split_drag(seen, strength, ahead, even)[0]
                pull[j, i] = strength * slope / mass[j]
                push[j, i] = drag / (mass[j] * speed)
        damping = 2.0 * (profile * speed - induced / speed**3) / mass - push.sum(axis=1)
        on = lag if model == LINEAR else 0.0
        return cls(lag, damping, pull, push + on * pull, on * push)

    @property
    def exists(self) -> bool:
        """Whether the steady state of the equations exists."""
        return bool(np.isfinite(self.damping).all())

    @property
    def most_rapid(self) -> float:
        """An upper bound on |lambda| of roots with a real part of 0 or more, in U_min / b.

        For such roots, |lambda|^2 is at most the sum of the other terms in Delta's largest row.
        Raises RunFailed if accelerations one lag ago have more effect than present ones.
        """
        own = 1.0 - np.abs(self.surge).sum(axis=1).max()
        if own <= 0.0:
            raise RunFailed(
                f"lag {self.lag:g}: accelerations one lag ago would have more effect than present "
                "ones, which is not possible: use a shorter lag"
            )
        by_speed = (np.abs(self.damping) + np.abs(self.push).sum(axis=1)).max() / own
        by_position = 2.0 * self.pull.sum(axis=1).max() / own
        return float(0.5 * (by_speed + sqrt(by_speed**2 + 4.0 * by_position)))

    def characteristic(self, root: complex) -> ComplexArray:
        """Return Delta(lambda), shape (birds, birds)."""
        past = np.exp(-root * self.lag)
        own = root * root + root * self.damping + self.pull.sum(axis=1)
        seen = self.pull + root * (self.push + root * self.surge)
        return np.asarray(np.diag(own) - past * seen)

    def reduced(self, root: complex) -> tuple[ComplexArray, ComplexArray]:
        """Return Delta without the root 0 of translation, and its derivative, (birds, birds).

        The first column is for the common speed, the others are for the spacings.
        """
        tau, past = self.lag, np.exp(-root * self.lag)
        all_pull, all_surge = self.pull.sum(axis=1), self.surge.sum(axis=1)
        answer = self.push.sum(axis=1) + root * all_surge
        moved, moved_slope = _moved_meanwhile(root, tau)
        common = root + self.damping - past * answer + all_pull * moved
        common_slope = 1.0 + past * (tau * answer - all_surge) + all_pull * moved_slope
        own_slope = np.diag(2.0 * root + self.damping)
        seen = self.pull + root * (self.push + root * self.surge)
        slope = own_slope + past * (tau * seen - self.push - 2.0 * root * self.surge)
        behind = formation.positions_by_gaps(len(self.damping))
        return (
            np.column_stack([common, self.characteristic(root) @ behind]),
            np.column_stack([common_slope, slope @ behind]),
        )

    def generator(self, nodes: int) -> FloatArray:
        """Return a square matrix with rightmost eigenvalues near the rightmost roots.

        Its state vector has the present spacings, and the speeds at Chebyshev's `nodes` + 1 points
        of the time from now back to t - tau. Present values evolve by the equations of motion, past
        ones by d/dtheta of the interpolating polynomial. Positions one lag ago are the present ones
        minus the integral of the speeds since then. Its size is birds - 1 + birds (nodes + 1).
        """
        birds = len(self.damping)
        gaps = birds - 1
        behind = formation.positions_by_gaps(birds)
        by_spacing = (self.pull - np.diag(self.pull.sum(axis=1))) @ behind
        if self.lag == 0.0:
            by_speed = self.push - np.diag(self.damping)  # no surge without a lag
            rows = np.zeros((gaps + birds, gaps + birds))
            rows[:gaps, gaps:] = np.diff(np.eye(birds), axis=0)
            rows[gaps:] = np.column_stack([by_spacing, by_speed])
            return rows
        derivative, weights = _chebyshev(nodes, self.lag)
        size = gaps + birds * (nodes + 1)
        rows = np.zeros((size, size))
        rows[:gaps, gaps : gaps + birds] = np.diff(np.eye(birds), axis=0)
        now = rows[gaps : gaps + birds]
        now[:, :gaps] = by_spacing
        now[:, gaps:] = np.kron(-weights, self.pull)
        now[:, gaps : gaps + birds] -= np.diag(self.damping)
        now[:, size - birds :] += self.push
        now[:, gaps:] += np.kron(derivative[-1], self.surge)
        rows[gaps + birds :, gaps:] = np.kron(derivative[1:], np.eye(birds))
        return rows

    def polish(self, root: complex) -> complex:
        """Return the root of the reduced determinant next to the approximate value `root`.

        This is Newton's method for the matrix: a step is the mu of least |mu| at which
        Delta + mu Delta' is singular. Unlike Newton's method for the determinant, it also converges
        well for roots that lie close together.
        """
        for _ in range(MOST_POLISHES):
            value, slope = self.reduced(root)
            steps = eigvals(-value, slope)
            step = complex(steps[np.argmin(np.abs(steps))])
            root += step
            if abs(step) <= POLISHED * self.most_rapid:
                break
        return root

    def rightmost_roots(self, count: int = 1) -> ComplexArray:
        """Return the `count` roots of largest real part, in falling order, in U_min / b.

        Complex roots come in pairs; both count. Without a lag, 2 birds - 1 roots exist.
        Raises RunFailed if the polished roots differ too much from those of the generator.
        """
        # exp(i omega theta) needs omega tau / 2 points, and some more for each further digit.
        nodes = LEAST_NODES + ceil(self.most_rapid * self.lag)
        found = eigvals(self.generator(nodes))
        found = found[np.argsort(-found.real, kind="stable")][:count]
        polished = np.array([self.polish(complex(root)) for root in found])
        strayed = np.abs(polished - found).max(initial=0.0)
        if strayed > STRAYED * self.most_rapid:
            raise RunFailed(
                f"a root of the characteristic equation moved by {strayed:.3g} in its "
                f"refinement, with {nodes} nodes and lag {self.lag:g}: ask for fewer roots"
            )
        return polished[np.argsort(-polished.real, kind="stable")]


def _moved_meanwhile(root: complex, lag: float) -> tuple[complex, complex]:
    """Return (1 - exp(-lambda tau)) / lambda and its derivative by lambda."""
    z = root * lag
    if abs(z) < 1e-2:  # the next terms are z^8 / 9! and z^7 / 9!, below rounding
        terms = [1.0, -1 / 2, 1 / 6, -1 / 24, 1 / 120, -1 / 720, 1 / 5040, -1 / 40320]
        value = sum(term * z**k for k, term in enumerate(terms))
        slope = sum(k * term * z ** (k - 1) for k, term in enumerate(terms) if k)
        return complex(lag * value), complex(lag * lag * slope)
    past = np.exp(-z)
    return complex((1.0 - past) / root), complex((lag * past - (1.0 - past) / root) / root)


def _chebyshev(nodes: int, lag: float) -> tuple[FloatArray, FloatArray]:
    """Return the differentiation matrix and the weights of integration on [-lag, 0].

    The points are -lag (1 - cos(pi k / nodes)) / 2, k = 0..nodes. (Trefethen, Spectral Methods in
    MATLAB, programs 6 and 30: `cheb` and `clencurt`.)
    """
    k = np.arange(nodes + 1)
    points = np.cos(np.pi * k / nodes)
    signs = np.where(k % 2 == 0, 1.0, -1.0)
    signs[[0, -1]] *= 2.0
    differences = points[:, np.newaxis] - points + np.eye(nodes + 1)
    derivative = np.outer(signs, 1.0 / signs) / differences
    derivative -= np.diag(derivative.sum(axis=1))
    # Weights: those that integrate every Chebyshev polynomial of the interpolant.
    orders = np.arange(0, nodes + 1, 2)
    halves = np.ones(nodes + 1)
    halves[[0, -1]] = 0.5
    ends = np.ones(len(orders))
    ends[0] = 0.5
    if nodes % 2 == 0:
        ends[-1] *= 0.5
    terms = 2.0 / (1.0 - orders**2) * ends
    weights = 2.0 / nodes * halves * (np.cos(np.pi * np.outer(k, orders) / nodes) @ terms)
    return derivative * (2.0 / lag), weights * (0.5 * lag)
