# SPDX-License-Identifier: Apache-2.0
"""How a steady state changes with the span ratio of each bird, by implicit differentiation.

At a steady state all forces F_i = R_i - sum_j D_ji are 0, with R_i = T_i - D_i(U*). A change of
lambda_l changes thrust, drag and circulation of bird l and moves all birds sideways: the lateral
distance of two birds contains lambda_l once if l is one of them, and twice if l is between them.
Let u = U*^2, and let d_l be the derivative by lambda_l at fixed u and fixed positions. D_ji and
C_ij = D_ij + D_ji go as 1 / u, so for any set S of birds, with the share s_S (see `all_to_all`),

    ds_S/dlambda_l = [sum_S d_l R_i - d_l W - s_S d_l X + q_S du/dlambda_l] / X,
    q_S = sum_S (dR_i/du + R_i / u),

where W is the sum of C of the pairs within S, and X that of the pairs across. For the set of all
birds nothing is across, and the bracket is 0: this gives du/dlambda_l. The positions follow from
the changes of forces and the stiffness of the pairs, as in a step of Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from flock_sim.physics import formation
from flock_sim.physics.aerodynamics import ahead_integral_and_slope, ahead_integral_gradient
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.physics.flock import Flock
from flock_sim.theory.equilibrium import Equilibrium
from flock_sim.theory.steady_speed import balances


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of steady states by the span ratios lambda_j; nan where no steady state exists.

    Mass, thrust, drag and circulation of bird j change with its lambda as in the model, and all
    wing tips keep their overlap.
    """

    speed_by_span: FloatArray
    """dU*/dlambda_j, shape (members, birds), in U_min."""
    spacing_by_span: FloatArray
    """d(x_{i+1} - x_i)/dlambda_j, shape (members, birds - 1, birds), in b.

    Near a stability limit, rounding of shares is a relative error of some 1e-15 / margin.
    """
    share_by_span: FloatArray
    """The derivatives of the shares of birds 1..i, shape (members, birds - 1, birds)."""
    margin_by_span: FloatArray
    """The derivatives of the margin, shape (members, birds).

    They are those of 1 - s_S of the state's `worst_set` S. If another set is equally bad, such as
    the mirror image of S, the margin is the smallest of several functions and has one-sided
    derivatives only. The result is then the derivative of the function of S. It is nan for a bird
    alone.
    """


def sensitivity(flock: Flock, state: Equilibrium) -> Sensitivity:
    """Return the derivatives of `state`, the steady states of `flock`, by all span ratios.

    A member of N birds takes O(N^2) operations with nearest-neighbour coupling. With all-to-all
    coupling, the N - 1 linear equations for the spacings take O(N^3).
    """
    birds, members = flock.birds, flock.members
    found = Sensitivity(
        speed_by_span=np.full((members, birds), np.nan),
        spacing_by_span=np.full((members, birds - 1, birds), np.nan),
        share_by_span=np.full((members, birds - 1, birds), np.nan),
        margin_by_span=np.full((members, birds), np.nan),
    )
    for m in np.flatnonzero(state.exists):
        one = _SteadyState(
            flock.select(np.array([m])),
            state.thrust_ratio[:, m],
            formation.positions(state.spacing[:, [m]])[:, 0],
            float(state.speed[m]) ** 2,
        )
        found.speed_by_span[m] = one.square_by_span / (2.0 * state.speed[m])
        found.spacing_by_span[m] = one.spacing_by_span()
        found.share_by_span[m] = one.share_by_span(state.share[:, m])
        if birds > 1:
            found.margin_by_span[m] = one.margin_by_span(state.worst_set[:, m], state.margin[m])
    return found


@dataclass(frozen=True)
class _Drags:
    """Drags Q_ij of birds i due to birds j, and their partial derivatives, in units of k.

    All have the shape (birds, birds) of i and j; they are 0 where birds do not interact.
    """

    by_lateral: FloatArray
    by_own: FloatArray
    """By lambda_i at fixed lateral distances."""
    by_other: FloatArray
    """By lambda_j at fixed lateral distances."""

    def of_pairs(self, chosen: npt.NDArray[np.bool_]) -> _Drags:
        """Return the drags of `chosen` birds i and j, shape (birds, birds); all others are 0."""
        return _Drags(self.by_lateral * chosen, self.by_own * chosen, self.by_other * chosen)

    def with_reaction(self) -> _Drags:
        """Return those of Q_ij + Q_ji."""
        return _Drags(
            self.by_lateral + self.by_lateral.T,
            self.by_own + self.by_other.T,
            self.by_other + self.by_own.T,
        )

    def later(self) -> FloatArray:
        """Return d_l of sum_{j > i} Q_ij, shape (birds, birds) of i and l."""
        by_lateral = np.triu(self.by_lateral, 1)
        beyond = np.cumsum(by_lateral[:, ::-1], axis=1)[:, ::-1] - by_lateral  # of all j > l
        by_others = np.triu(self.by_other + self.by_lateral + 2.0 * beyond, 1)
        by_own = np.triu(self.by_own + self.by_lateral, 1).sum(axis=1)
        return np.asarray(by_others + np.diag(by_own))

    def earlier(self) -> FloatArray:
        """Return d_l of sum_{j < i} Q_ij, shape (birds, birds) of i and l."""
        mirrored = (self.by_lateral, self.by_own, self.by_other)
        return _Drags(*(part[::-1, ::-1] for part in mirrored)).later()[::-1, ::-1]


class _SteadyState:
    """The steady state of one flock; all forces are in units of k."""

    def __init__(
        self, flock: Flock, thrust_ratio: FloatArray, position: FloatArray, square: float
    ) -> None:
        self.flock = flock
        self.position = position
        ratio = self.ratio = flock.span_ratio[:, 0]
        cruise_ratio = flock.scales.cruise_ratio * thrust_ratio
        needed = balances(ratio, square, cruise_ratio)
        thrust = 2.0 * cruise_ratio - 1.0 / square
        self.needed_by_span = 2.0 * ratio * (2.0 * ratio**2 * thrust - square)
        """d_i R_i, shape (birds,)."""
        self.by_square = ratio**2 * ((ratio / square) ** 2 - 1.0) + needed / square
        """dR_i/du + R_i / u, shape (birds,)."""
        tail, head = flock.pairs.T
        self.strength = 0.5 * flock.scales.saving_ratio * (ratio[tail] * ratio[head]) ** 2 / square
        """K_ij / k, shape (pairs,)."""
        self.ahead = np.empty((5, len(tail)))
        """f and its derivatives by |x|, y and both vortex half-spans, shape (5, pairs)."""
        half_span, lateral = flock.half_span[:, 0].copy(), flock.lateral[:, 0].copy()
        _fill_ahead(position, half_span, flock.pairs, lateral, self.ahead)

    @cached_property
    def felt(self) -> _Drags:
        """D_ji of all birds i."""
        tail, head = self.flock.pairs.T
        ahead = self.ahead[[0, 2, 3, 4]]
        behind = 2.0 * self._even() - ahead
        tail_is_behind = self.position[tail] < self.position[head]
        on_tail = np.where(tail_is_behind, behind, ahead)
        on_head = np.where(tail_is_behind, ahead, behind)
        return _Drags(
            self._matrix(self.strength * on_tail[1], self.strength * on_head[1]),
            self._matrix(self._by_span(on_tail, 2, tail), self._by_span(on_head, 3, head)),
            self._matrix(self._by_span(on_tail, 3, head), self._by_span(on_head, 2, tail)),
        )

    def _even(self) -> FloatArray:
        """Return E and its derivatives by y and both vortex half-spans, shape (4, pairs)."""
        tail, head = self.flock.half_span[self.flock.pairs.T, 0]
        lateral = self.flock.lateral[:, 0]
        outer = (lateral + tail + head) * (lateral - tail - head)
        inner = (lateral + tail - head) * (lateral - tail + head)
        unequal = (tail + head) * (tail - head)
        gradient = np.stack(
            [
                2.0 * lateral * tail * head,
                -head * (lateral**2 + unequal),
                -tail * (lateral**2 - unequal),
            ]
        )
        return np.vstack([self.flock.even[:, 0], 4.0 * gradient / (outer * inner)])

    def _by_span(self, integral: FloatArray, row: int, birds: npt.NDArray[np.int64]) -> FloatArray:
        """Return the derivative of a drag by the span ratios of `birds` (pairs,), one of each pair.

        `integral` (4, pairs) is as `_even`; `row` is that of the birds' half-spans.
        """
        by_half = formation.VORTEX_FRACTION * integral[row]
        return np.asarray(self.strength * (2.0 * integral[0] / self.ratio[birds] + by_half))

    def _matrix(self, on_tail: FloatArray, on_head: FloatArray) -> FloatArray:
        """Return values of pairs (pairs,), on either bird, as a matrix of bird and other bird."""
        tail, head = self.flock.pairs.T
        matrix = np.zeros((self.flock.birds, self.flock.birds))
        matrix[tail, head], matrix[head, tail] = on_tail, on_head
        return matrix

    @cached_property
    def saved(self) -> _Drags:
        """C_ij of all pairs."""
        return self.felt.with_reaction()

    @cached_property
    def square_by_span(self) -> FloatArray:
        """du/dlambda_l, shape (birds,)."""
        saved = self.saved.later().sum(axis=0)
        return np.asarray((saved - self.needed_by_span) / self.by_square.sum())

    def share_by_span(self, share: FloatArray) -> FloatArray:
        """Return the derivatives of `share`, (birds - 1,), that of birds 1..i for each gap i."""
        behind = np.tri(self.flock.birds, dtype=bool)[:-1]
        earlier, later = self.saved.earlier(), self.saved.later()
        within = np.cumsum(earlier, axis=0)[:-1]
        beyond = np.cumsum(later[::-1], axis=0)[::-1][1:]
        return self._of_sets(behind, share, within, later.sum(axis=0) - within - beyond)

    def margin_by_span(self, worst: npt.NDArray[np.bool_], margin: float) -> FloatArray:
        """Return the derivatives of `margin`, that of the set `worst` (birds,), shape (birds,)."""
        within = self.saved.of_pairs(worst & worst[:, np.newaxis])
        across = self.saved.of_pairs(worst != worst[:, np.newaxis])
        of_share = self._of_sets(
            worst[np.newaxis],
            np.array([1.0 - margin]),
            within.later().sum(axis=0, keepdims=True),
            across.later().sum(axis=0, keepdims=True),
        )
        return np.asarray(-of_share[0])

    def _of_sets(
        self,
        behind: npt.NDArray[np.bool_],
        share: FloatArray,
        within_by_span: FloatArray,
        across_by_span: FloatArray,
    ) -> FloatArray:
        """Return the derivatives of the shares (sets,) of the sets `behind`, (sets, birds).

        `within_by_span` and `across_by_span` are d_l W and d_l X; all have the shape (sets, birds).
        """
        tail, head = self.flock.pairs.T
        saved = 2.0 * self.strength * self.flock.even[:, 0]
        across = (behind[:, tail] != behind[:, head]) @ saved
        changed = behind * self.needed_by_span - within_by_span
        changed -= share[:, np.newaxis] * across_by_span
        changed += np.outer(behind @ self.by_square, self.square_by_span)
        return np.asarray(changed / across[:, np.newaxis])

    def spacing_by_span(self) -> FloatArray:
        """Return the derivatives of spacings, shape (birds - 1, birds).

        The unknowns are the distances between birds in their streamwise order. With
        nearest-neighbour coupling the birds' own order is used, since each distance is then that of
        one pair, and the equations are independent.
        """
        felt = self.felt.later() + self.felt.earlier()
        force = np.outer(self.by_square, self.square_by_span) - felt
        force += np.diag(self.needed_by_span)
        stiffness = self.strength * self.ahead[1]
        if self.flock.coupling == "nearest":
            return np.asarray(-np.cumsum(force, axis=0)[:-1] / stiffness[:, np.newaxis])
        order = np.argsort(self.position, kind="stable")
        pull = -np.cumsum(force[order], axis=0)[:-1]
        # The sum of the stiffness of all pairs that gaps i and j separate.
        ranked = self._matrix(stiffness, stiffness)[order][:, order]
        across = np.cumsum(np.triu(ranked, 1)[:-1, 1:], axis=0)
        across = np.triu(np.cumsum(across[:, ::-1], axis=1)[:, ::-1])
        matrix = across + np.triu(across, 1).T
        scale = 1.0 / np.sqrt(np.diag(matrix))
        widening = (
            np.linalg.solve(matrix * np.outer(scale, scale), scale[:, np.newaxis] * pull)
            * scale[:, np.newaxis]
        )
        by_position = np.zeros_like(force)
        by_position[order[1:]] = np.cumsum(widening, axis=0)
        return np.asarray(np.diff(by_position, axis=0))


@kernel
def _fill_ahead(
    position: FloatArray,
    half_span: FloatArray,
    pairs: npt.NDArray[np.int64],
    lateral: FloatArray,
    ahead: FloatArray,
) -> None:
    """Fill `ahead` (5, pairs) with f and its derivatives by |x|, y and both vortex half-spans."""
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        distance = abs(position[j] - position[i])
        ahead[0, k], ahead[1, k] = ahead_integral_and_slope(
            distance, lateral[k], half_span[i], half_span[j]
        )
        ahead[2, k], ahead[3, k], ahead[4, k] = ahead_integral_gradient(
            distance, lateral[k], half_span[i], half_span[j]
        )
