# SPDX-License-Identifier: Apache-2.0
"""The stability of formations in which birds see each other with a lag, and critical lags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, nan

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.theory.delayed.all_to_all import delayed_all_to_all
from flock_sim.theory.delayed.linearisation import HOLD, LINEAR, MODELS, DelayedLinearisation
from flock_sim.theory.delayed.nearest import delayed_nearest
from flock_sim.theory.equilibrium import equilibrium

LAG_RESOLUTION = 1e-12
"""Resolution of critical lags, relative above 1 b / U_min."""


@dataclass(frozen=True)
class Crossing:
    """A lag at which a flock loses stability, or regains it."""

    lag: float
    """tau, in b / U_min."""
    frequency: float
    """Imaginary part of the root that crosses, in U_min / b: the frequency of the oscillation."""
    lost: bool
    """Whether stability is lost as the lag grows."""


def steady_flight(flock: Flock, lag: float, model: str) -> tuple[FloatArray, float]:
    """Return spacings (birds - 1,) in b and speed U* of a flock of one member; nan without one.

    With `hold` they depend on `lag`, with `linear` they are those of `equilibrium`. Raises
    ValueError for an unknown model, several members, or a lag that is negative or not finite.
    """
    if model not in MODELS:
        raise ValueError(f"model = {model!r}: must be one of {', '.join(MODELS)}")
    if flock.members != 1:
        raise ValueError(f"the flock has {flock.members} members: must be 1")
    if not (isfinite(lag) and lag >= 0.0):
        raise ValueError(f"lag = {lag:g}: must be finite and 0 or more")
    if model == HOLD and flock.coupling == "all":
        return delayed_all_to_all(flock, lag)
    state = equilibrium(flock) if model == LINEAR else delayed_nearest(flock, lag)
    return state.spacing[:, 0], float(state.speed[0])


def delayed_linearisation(flock: Flock, lag: float, model: str) -> DelayedLinearisation:
    """Return the linear equations about the steady state of `flock` at `lag`; nan without one.

    `lag` is tau >= 0 in b / U_min, `model` one of `MODELS`; the flock has one member.
    """
    return DelayedLinearisation.of(flock, *steady_flight(flock, lag, model), lag, model)


def growth(flock: Flock, lag: float, model: str) -> float:
    """Return the largest real part of a root, in U_min / b: stable below 0; nan without a state."""
    motion = delayed_linearisation(flock, lag, model)
    return float(motion.rightmost_roots()[0].real) if motion.exists else nan


def crossings(flock: Flock, lags: Sequence[float] | FloatArray, model: str) -> list[Crossing]:
    """Return the lags at which `growth` changes sign, in ascending order.

    The search compares neighbouring values of the ascending `lags`. It does not find an interval of
    instability that lies between two of them, nor a change next to a lag without a steady state.
    """
    from scipy.optimize import brentq

    def rate(lag: float) -> float:
        return growth(flock, lag, model)

    rates = [rate(float(lag)) for lag in lags]
    found = []
    for low, high, before, after in zip(lags[:-1], lags[1:], rates[:-1], rates[1:]):
        if before * after < 0.0:
            lag = float(brentq(rate, low, high, xtol=LAG_RESOLUTION, rtol=LAG_RESOLUTION))
            root = delayed_linearisation(flock, lag, model).rightmost_roots()[0]
            found.append(Crossing(lag, float(abs(root.imag)), bool(before < 0.0)))
    return found
