# SPDX-License-Identifier: Apache-2.0
"""The steady state of any flock: whether a formation exists, its shape, and its margin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flock_sim.errors import RunFailed
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.physics.scaling import drag_reduction
from flock_sim.theory import nearest
from flock_sim.theory.steady_speed import balances

TIE = 1e-9
"""Largest difference of the margins of two gaps that count as equally weak."""

CLOSEST_START = 0.02
"""Least distance of shares from 0 or 1 at the start of the search for the all-to-all state."""


@dataclass(frozen=True)
class Equilibrium:
    """The steady states of an ensemble; nan if none exists."""

    span_ratio: FloatArray
    """lambda_i, shape (birds, members)."""
    thrust_ratio: FloatArray
    """T_i over the thrust lambda_i^4 T_0 of the model, shape (birds, members)."""
    exists: npt.NDArray[np.bool_]
    """Whether the flock can fly in formation, shape (members,)."""
    speed: FloatArray
    """U*, shape (members,), in U_min."""
    balanced_speed: FloatArray
    """The speed at which all forces sum to 0, shape (members,): U*, if a formation exists.

    nan if thrust balances drag at no speed.
    """
    spacing: FloatArray
    """x_{i+1} - x_i, shape (birds - 1, members), in b."""
    share: FloatArray
    """The share of birds 1..i in the saving across gap i, shape (birds - 1, members).

    It is in (0, 1) if a formation exists; with nearest-neighbour coupling it is D_{i+1,i} / C_i. If
    no formation exists, it is the share that a balance of forces at U* would need.
    """
    margin: FloatArray
    """Least distance of the share of any set of birds from 1, shape (members,).

    It is above 0 exactly if a formation exists. The share of the birds outside of a set is one less
    that of the set, so it is the least distance from 0 or 1 as well. With nearest-neighbour
    coupling it is that of `share`. The margin of a single bird is inf.
    """
    worst_set: npt.NDArray[np.bool_]
    """Whether a bird is in the set of this share, shape (birds, members).

    The birds of this set are the first to fall behind all others. No bird is in it for a bird
    alone, and if no speed balances thrust and drag.
    """
    drag_reduction: FloatArray
    """eta_i = -(sum_j D_ji) / D_0, shape (birds, members)."""

    @property
    def position(self) -> FloatArray:
        """x_i from the leader, shape (birds, members), in b."""
        position = formation.positions(self.spacing)
        return np.asarray(position - position[formation.leader(len(position)) - 1])

    @property
    def lateral(self) -> FloatArray:
        """y_i from the leader, shape (birds, members), in b."""
        return formation.lateral_positions(self.span_ratio)

    @property
    def weakest_gap(self) -> npt.NDArray[np.int64]:
        """The gap whose share is nearest to 0 or 1, shape (members,).

        Gap i is between birds i and i + 1. Of equally weak gaps, such as a gap and its mirror
        image, it is the first. It is 0 for a bird alone, and if no speed balances thrust and drag.
        """
        return _weakest_gap(self.share)

    @property
    def worst_gap(self) -> npt.NDArray[np.int64]:
        """The gap between `worst_set` and all other birds, shape (members,).

        It is 0 if more than one gap is between them, or if there is no such set.
        """
        between = self.worst_set[1:] != self.worst_set[:-1]
        if not len(between):
            return np.zeros(len(self.exists), dtype=np.int64)
        return np.where(between.sum(axis=0) == 1, np.argmax(between, axis=0) + 1, 0)


def equilibrium(flock: Flock, thrust_ratio: FloatArray | None = None) -> Equilibrium:
    """Return the steady states of all members of `flock`: exact for `nearest`, Newton for `all`.

    `thrust_ratio`, shape (birds, members), has the thrust of each bird over that of the model,
    lambda^4 T_0; None: all are 1.
    Raises RunFailed if Newton's method does not find a state that exists.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a member that overflows is nan
        return _equilibrium(flock, _thrust_ratios(flock, thrust_ratio))


def _equilibrium(flock: Flock, thrust_ratio: FloatArray) -> Equilibrium:
    if flock.coupling == "nearest" or flock.birds == 1:
        square, share = nearest_shares(flock, thrust_ratio)
        margin = distance_from_end(share).min(axis=0, initial=np.inf)
        worst = _worst_of_gaps(share)
        spacing = np.empty_like(share)
        nearest.fill_spacings(flock.span_ratio, share, spacing)
    else:
        square, share, spacing, margin, worst = _all_to_all(flock, thrust_ratio)
    exists = (margin > 0.0) & np.isfinite(square)
    known = np.where(exists, square, np.nan)
    spacing[:, ~exists] = np.nan
    ratio = flock.scales.cruise_ratio
    needed = balances(flock.span_ratio, known, ratio * thrust_ratio)
    return Equilibrium(
        span_ratio=flock.span_ratio,
        thrust_ratio=thrust_ratio,
        exists=exists,
        speed=np.sqrt(known),
        balanced_speed=np.sqrt(square),
        spacing=spacing,
        share=share,
        margin=margin,
        worst_set=worst,
        drag_reduction=drag_reduction(needed, 2.0 * ratio),
    )


def nearest_shares(
    flock: Flock, thrust_ratio: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return U*^2 (members,) and the shares (birds - 1, members) of nearest-neighbour coupling.

    `thrust_ratio` is as in `equilibrium`.
    """
    square = np.empty(flock.members)
    share = np.empty((flock.birds - 1, flock.members))
    scales = flock.scales
    thrust = _thrust_ratios(flock, thrust_ratio)
    nearest.fill_shares(
        flock.span_ratio, thrust, scales.cruise_ratio, scales.saving_ratio, square, share
    )
    return square, share


def _thrust_ratios(flock: Flock, given: FloatArray | None) -> FloatArray:
    """Return the argument `thrust_ratio` of `equilibrium` in the layout of kernels."""
    if given is None:
        return np.ones_like(flock.span_ratio)
    return np.ascontiguousarray(np.broadcast_to(given, flock.span_ratio.shape), dtype=np.float64)


def distance_from_end(share: FloatArray) -> FloatArray:
    """Return the distance of shares from the nearer of 0 and 1; below 0 outside of (0, 1)."""
    distance: FloatArray = np.minimum(share, 1.0 - share)
    return distance


def _weakest_gap(share: FloatArray) -> npt.NDArray[np.int64]:
    if not len(share):
        return np.zeros(share.shape[1], dtype=np.int64)
    margin = distance_from_end(share)
    first = np.argmax(margin <= margin.min(axis=0) + TIE, axis=0) + 1
    return np.where(np.isnan(margin).any(axis=0), 0, first)


def _worst_of_gaps(share: FloatArray) -> npt.NDArray[np.bool_]:
    """Return the birds on that side of the weakest gap that falls behind, (birds, members)."""
    gap = _weakest_gap(share)
    bird = np.arange(len(share) + 1)[:, np.newaxis]
    if not len(share):
        return np.zeros_like(bird == gap)
    of_gap = np.take_along_axis(share, np.maximum(gap - 1, 0)[np.newaxis], axis=0)[0]
    return np.where(of_gap >= 0.5, bird < gap, bird >= gap) & (gap > 0)


def margins(flock: Flock, thrust_ratio: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Return U*^2 and the margins of all members of `flock`, both (members,), without spacings.

    `thrust_ratio` is as for `equilibrium`.
    """
    ratio = _thrust_ratios(flock, thrust_ratio)
    with np.errstate(over="ignore", invalid="ignore"):
        if flock.coupling == "nearest" or flock.birds == 1:
            square, share = nearest_shares(flock, ratio)
            return square, distance_from_end(share).min(axis=0, initial=np.inf)
        square, _, _, _, margin, _ = _all_to_all_shares(flock, ratio)
        return square, margin


def _all_to_all_shares(
    flock: Flock, thrust_ratio: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Return U*^2, K_ij / k, R_j / k, shares, margins and worst sets of all-to-all coupling."""
    from flock_sim.theory import all_to_all, worst_sets  # kernels not used for `nearest`

    square = np.empty(flock.members)
    share = np.empty((flock.birds - 1, flock.members))
    strength, needed = np.empty_like(flock.even), np.empty_like(flock.span_ratio)
    all_to_all.fill_shares(
        flock.span_ratio,
        thrust_ratio,
        flock.pairs,
        flock.even,
        flock.scales.cruise_ratio,
        0.5 * flock.scales.saving_ratio,
        square,
        strength,
        needed,
        share,
    )
    margin, worst = np.empty(flock.members), _worst_of_gaps(share)
    worst_sets.find_worst_sets(needed, flock.pairs, 2.0 * strength * flock.even, worst, margin)
    return square, strength, needed, share, margin, worst


def _all_to_all(
    flock: Flock, thrust_ratio: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Return U*^2, shares, spacings, margins and worst sets of all-to-all coupling."""
    from flock_sim.theory import all_to_all

    square, strength, needed, share, margin, worst = _all_to_all_shares(flock, thrust_ratio)
    spacing = np.empty_like(share)
    near = np.clip(nearest_shares(flock, thrust_ratio)[1], CLOSEST_START, 1.0 - CLOSEST_START)
    nearest.fill_spacings(flock.span_ratio, near, spacing)
    start = formation.positions(np.nan_to_num(spacing))
    for m in np.flatnonzero(margin > 0.0):
        position = start[:, m].copy()
        found = all_to_all.settle(
            position,
            needed[:, m].copy(),
            flock.half_span[:, m].copy(),
            flock.pairs,
            flock.lateral[:, m].copy(),
            flock.even[:, m].copy(),
            strength[:, m].copy(),
        )
        if not found:
            raise RunFailed(
                f"member {m + 1}: Newton's method did not find the steady state in "
                f"{all_to_all.MOST_ITERATIONS} iterations; its margin is {margin[m]:.3g}"
            )
        spacing[:, m] = np.diff(position)
    return square, share, spacing, margin, worst
