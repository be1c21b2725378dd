# SPDX-License-Identifier: Apache-2.0
"""The metrics of a flock at one time: whether it holds together, its shape, and drag savings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.interaction import ahead_integral_and_slope, even_part, split_drag
from flock_sim.physics.scaling import Scales

STABLE_BELOW = 1e-4
"""A flock is stable if sigma_U is below this limit, in U_min."""


@dataclass(frozen=True)
class Metrics:
    """The metrics of a flock; lists have one entry per member; birds go from tail to tail."""

    birds: int
    members: int
    coupling: str
    dt: float
    steps: int
    t_final: float
    leader: int
    mean_speed: FloatArray
    """<U>, shape (members,), in U_min."""
    speed_std: FloatArray
    """sigma_U = sqrt(<U^2> - <U>^2), shape (members,), in U_min."""
    stable: list[bool]
    spacing: FloatArray
    """x_{i+1} - x_i, shape (members, birds - 1), in b."""
    position: FloatArray
    """x_i relative to the leader, shape (members, birds), in b."""
    lateral: FloatArray
    """y_i relative to the leader, shape (members, birds), in b."""
    drag_reduction: FloatArray
    """eta_i = -(sum_j D_ji) / D_0, D_0 that of the standard bird at cruise; (members, birds)."""
    mean_drag_reduction: FloatArray
    """eta, the mean over the birds, shape (members,)."""
    hierarchical: list[bool]
    """Whether spacing falls strictly from tail to leader on the left wing. Eq. (ordering)."""
    profile_error: list[float | None]
    """Largest |D_{i,i-1} / C - (1 - (i - 1) / N)| on the left wing, Eq. (linear_general_x);
    None where it does not apply: not homogeneous, not nearest-neighbour, or N even."""

    def falling_wings(self, m: int) -> tuple[bool, bool]:
        """Return whether spacing falls strictly to the leader on the left and on the right wing.

        A wing with fewer than two spacings counts as falling.
        """
        right = -self.spacing[m][self.leader - 1 :][::-1]
        falls = np.all(right[1:] < right[:-1]) and np.all(np.isfinite(right))
        return self.hierarchical[m], bool(falls)

    def as_json(self) -> dict[str, object]:
        """Return plain lists and numbers, with None for values that are not finite."""
        return {name: plain(value) for name, value in vars(self).items()}


def measure(configuration: FlockConfiguration, state: FlockState) -> Metrics:
    """Return the metrics of a flock at `state`, of all members."""
    birds = configuration.birds
    leader = formation.leader(birds)
    with np.errstate(invalid="ignore", over="ignore"):
        mean = mean_over_birds(state.speed)
        deviation = speed_std(state.speed)
        spacing = state.spacing
        reduction = state.drag_reduction(Scales.of(configuration))
        left = spacing[: leader - 1]
        ordered = np.all(left[1:] < left[:-1], axis=0) & np.all(np.isfinite(left), axis=0)
        relative = state.from_leader
        mean_reduction = mean_over_birds(reduction)
        profile = _profile_error(configuration, left)
    return Metrics(
        birds=birds,
        members=configuration.members,
        coupling=configuration.coupling,
        dt=configuration.dt,
        steps=state.step,
        t_final=configuration.time(state.step),
        leader=leader,
        mean_speed=mean,
        speed_std=deviation,
        stable=[bool(ok) for ok in (deviation < STABLE_BELOW) & state.finite],
        spacing=spacing.T,
        position=relative.T,
        lateral=formation.lateral_positions(configuration.span_ratio).T,
        drag_reduction=reduction.T,
        mean_drag_reduction=mean_reduction,
        hierarchical=[bool(ok) for ok in ordered],
        profile_error=profile,
    )


def mean_over_birds(values: FloatArray) -> FloatArray:
    """Return the mean of `values`, shape (birds, ...), over the birds; they are added in order.

    The order in which NumPy's own sums add depends on the shape and on how NumPy was built.
    """
    return np.asarray(np.add.accumulate(values, axis=0)[-1] / len(values))


def speed_std(speed: FloatArray) -> FloatArray:
    """Return sigma_U of `speed`, shape (birds, ...), in its unit."""
    # The mean of squared deviations is <U^2> - <U>^2 without its cancellation.
    deviation = speed - mean_over_birds(speed)
    return np.asarray(np.sqrt(mean_over_birds(deviation * deviation)))


def _profile_error(configuration: FlockConfiguration, left: FloatArray) -> list[float | None]:
    """Return the deviation from the linear law; `left`: spacings, shape (n - 1, members)."""
    birds = configuration.birds
    errors: list[float | None] = []
    for m in range(configuration.members):
        ratio = configuration.span_ratio[:, m]
        if (
            configuration.coupling != "nearest"
            or birds % 2 == 0
            or np.ptp(ratio) > 0.0
            or birds == 1
        ):
            errors.append(None)
            continue
        half = formation.VORTEX_FRACTION * float(ratio[0])
        lateral = 2.0 * float(ratio[0]) + formation.TIP_SPACING
        # C = Gamma^2 E / (2 pi) and D_{i,i-1} = Gamma^2 I / (4 pi): their ratio is I / (2 E).
        even = even_part(lateral, half, half)
        integral = [
            split_drag(x, 1.0, ahead_integral_and_slope(abs(x), lateral, half, half)[0], even)[0]
            for x in left[:, m].tolist()
        ]
        share = np.array(integral) / (2.0 * even)
        gap = np.arange(1, len(left) + 1)
        errors.append(float(np.max(np.abs(share - (1.0 - gap / birds)))))
    return errors


def plain(value: object) -> object:
    """Return arrays as lists, and None for values that are not finite: JSON has no nan."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
