# SPDX-License-Identifier: Apache-2.0
"""The flights of the coupling study: the effect of late, rare and lost messages on a formation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flock_sim.analysis.flight_verdict import Flown
from flock_sim.analysis.verdict import APART, HOLDS, STALLED
from flock_sim.configuration import span_ratios
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.reference.integrator import Reference
from flock_sim.theory.delayed.linearisation import HOLD, LINEAR
from flock_sim.theory.delayed.nearest import delayed_nearest
from flock_sim.theory.delayed.stability import steady_flight
from flock_sim.theory.span_limits import modified_span_ratios
from flock_tools.experiments.workers import workers

DELAYS = (0, 1, 2, 3, 5, 7, 10, 14, 20, 28, 35, 40, 41, 43, 46, 50)
"""Delays of the flights of three geese, in steps of 1 b / U_min."""

NEAR = 0.05
"""Distance from the theoretical gap, in b; the gaps of three geese are longer than 0.26."""

T_STEADY = 1e5
"""Flight time of three geese, in b / U_min."""

BIRDS, MODIFIED = 7, 2
"""Number of birds of the flock whose limits are searched, and its bird of modified span."""

SPAN_RATIOS: dict[str, tuple[float, ...]] = {
    HOLD: tuple(round(0.85 + 0.005 * k, 4) for k in range(51)),
    LINEAR: tuple(round(0.95 + 0.0025 * k, 4) for k in range(57)),
}
"""Span ratios of the modified bird that are tried, by model."""

T_LIMITS = 5e4

FAULTS: dict[str, dict[str, tuple[float, ...]]] = {
    HOLD: {"interval": (1, 2), "drop": (0.1, 0.2, 0.3)},
    LINEAR: {
        "delay": (0, 10, 20, 30, 40, 50),
        "interval": (1, 20, 40, 60, 80, 120, 160),
        "drop": (0, 0.5, 0.9, 0.95, 0.97, 0.975, 0.98, 0.985),
    },
}
"""Values of each key of links at which limits are searched, by model.

Over links that hold for longer, a flock settles too slowly for a verdict at T_LIMITS.
"""

LAGS = np.geomspace(0.05, 5.0, 25)
"""Lags at which theory gives the limits of flocks over `hold` links, in b / U_min."""


@dataclass(frozen=True)
class Delayed:
    """The flight of three geese over delayed links."""

    model: str
    delay: int
    """In steps."""
    lag: float
    """Mean age of the received states, in b / U_min."""
    speed: float
    """Mean over the last tenth of the flight, as `gap` and `swing`, in U_min."""
    gap: float
    """From tail to leader, in b."""
    swing: float
    """Largest minus smallest gap, in b."""
    settled: float
    """Time from which the gap stays within NEAR of theory, in b / U_min; inf if it never does."""
    theory_speed: float
    theory_gap: float


def delayed_flights(model: str) -> list[Delayed]:
    """Fly three geese over `model` with each of DELAYS, in steps of 1 b / U_min."""
    link = f"{model}:delay=" + "/".join(map(str, DELAYS))
    configuration = FlockConfiguration(birds=3, t_max=T_STEADY, record_every=10, links=(link,))
    states = list(Reference(configuration).fly())
    speed = np.array([state.mean_speed for state in states])
    gap = np.array([state.position[1] - state.position[0] for state in states])
    time = np.array([state.step * configuration.dt for state in states])
    late = slice(len(states) * 9 // 10, None)
    found = []
    flock = Flock.of(FlockConfiguration(birds=3))
    for m, delay in enumerate(DELAYS):
        lag = (delay + 0.5) * configuration.dt
        spacing, steady = steady_flight(flock, lag, model)
        last = np.flatnonzero(np.abs(gap[:, m] - spacing[0]) >= NEAR)[-1]
        found.append(
            Delayed(
                model,
                delay,
                lag,
                float(speed[late, :, m].mean()),
                float(gap[late, m].mean()),
                float(np.ptp(gap[late, m])),
                float(time[last + 1]) if last + 1 < len(time) else np.inf,
                steady,
                float(spacing[0]),
            )
        )
    return found


@dataclass(frozen=True)
class Held:
    """The span ratios of one bird for which a flock stays together over given links."""

    model: str
    key: str
    value: float
    kept: tuple[float, ...]
    """The contiguous part of SPAN_RATIOS around 1; empty if a flock of equal birds parts, too."""

    @property
    def age(self) -> float:
        """Mean age of the received states, in steps of 1 b / U_min."""
        if self.key == "delay":
            return self.value + 0.5
        return 0.5 * self.value if self.key == "interval" else 0.5 + self.value / (1.0 - self.value)


def held(model: str, key: str, value: float) -> Held:
    """Fly seven birds, one modified, over links of `model` with `key` = `value`.

    They stay together if the verdict on their flight is `holds`, see `_around_one`.
    """
    ratios = SPAN_RATIOS[model]
    flock = FlockConfiguration(birds=BIRDS)
    changed = modified_span_ratios(flock, [MODIFIED] * len(ratios), ratios)
    configuration = replace(
        flock,
        t_max=T_LIMITS,
        record_every=100,
        links=(f"{model}:{key}={value:g}",),
        span_ratios=span_ratios.entries(changed),
    )
    words = Flown(configuration, list(Reference(configuration).fly())).verdicts().verdict
    return Held(model, key, value, _around_one(ratios, words))


def _around_one(ratios: Sequence[float], words: Sequence[str]) -> tuple[float, ...]:
    """Return the ratios around 1 from the first to the last with the verdict `holds`.

    Between them none is apart or stalled; some may still be settling.
    """
    one = ratios.index(1.0)
    if words[one] != HOLDS:
        return ()
    ended = [k for k, word in enumerate(words) if word in (APART, STALLED)]
    first = max((k + 1 for k in ended if k < one), default=0)
    last = min((k for k in ended if k > one), default=len(ratios))
    held = [k for k in range(first, last) if words[k] == HOLDS]
    return tuple(ratios[held[0] : held[-1] + 1])


def late_limits(lag: float) -> tuple[float, float]:
    """Return the range of ratios with a steady state if all birds hold states of age `lag`."""
    configuration = FlockConfiguration(birds=BIRDS)

    def flies(ratio: float) -> bool:
        flock = Flock.of(configuration, modified_span_ratios(configuration, [MODIFIED], [ratio]))
        return bool(np.isfinite(delayed_nearest(flock, lag).speed))

    def end(inside: float, outside: float) -> float:
        while abs(outside - inside) > 1e-6:
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if flies(middle) else (inside, middle)
        return inside

    return end(1.0, 0.5), end(1.0, 1.5)


def limits_over_links(show: Callable[[float], None]) -> Iterator[Held]:
    """Search the limits for all of FAULTS. `show` is called after each result."""
    asked = [
        (model, key, value)
        for model, keys in FAULTS.items()
        for key, values in keys.items()
        for value in values
    ]
    with workers(None) as pool:
        for found in pool.executor.map(lambda what: held(*what), asked):
            show(1)
            yield found
