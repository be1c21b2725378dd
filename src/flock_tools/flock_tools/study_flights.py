# SPDX-License-Identifier: Apache-2.0
"""The flights of the study of coupling: what late, rare and lost messages do to a formation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.flock import Flock
from flock_sim.core.kernel import FloatArray
from flock_sim.core.lag_stability import steady_flight
from flock_sim.core.lagged_chain import lagged_chain
from flock_sim.core.lagged_motion import HOLD, LINEAR
from flock_sim.core.metrics import STABLE_BELOW
from flock_sim.core.monolith import Monolith
from flock_tools.table import Table
from flock_tools.workers import workers

BoolArray = npt.NDArray[np.bool_]

DELAYS = (0, 1, 2, 3, 5, 7, 10, 14, 20, 28, 35, 40, 41, 43, 46, 50)
"""In steps of 1 b / U_min, of three geese."""

NEAR = 0.05
"""In b; the gaps of three geese are longer than 0.26."""

T_STEADY = 1e5
"""For how long three geese are flown, in b / U_min."""

BIRDS, MODIFIED = 7, 2
"""The flock whose limits are looked for, and the bird in it that is of another span."""

SPAN_RATIOS: dict[str, tuple[float, ...]] = {
    HOLD: tuple(round(0.85 + 0.005 * k, 4) for k in range(51)),
    LINEAR: tuple(round(0.95 + 0.0025 * k, 4) for k in range(57)),
}
"""Those of the modified bird that are tried, by the model."""

T_LIMITS = 5e4

FAULTS: dict[str, dict[str, tuple[float, ...]]] = {
    HOLD: {"interval": (1, 2), "drop": (0.1, 0.2, 0.3)},
    LINEAR: {
        "delay": (0, 10, 20, 30, 40, 50),
        "interval": (1, 20, 40, 60, 80, 120, 160),
        "drop": (0, 0.5, 0.9, 0.95, 0.97, 0.975, 0.98, 0.985),
    },
}
"""The values of a key of links that limits are looked for at, by the model.

What is held for longer lets a flock settle so slowly that T_LIMITS is too short for a verdict.
"""

LAGS = np.geomspace(0.05, 5.0, 25)
"""Those at which theory tells the limits of flocks that hold what they see, in b / U_min."""


@dataclass(frozen=True)
class Lagged:
    """What became of three geese that see each other late."""

    model: str
    delay: int
    """In steps."""
    lag: float
    """How old what they know is, on average, in b / U_min."""
    speed: float
    """In U_min; of the last tenth of the flight, as all that follows."""
    gap: float
    """From tail to leader, in b."""
    swing: float
    """By how much the gap changes, in b."""
    settled: float
    """When the gap came within NEAR of theory for good, in b / U_min; inf if it never did."""
    theory_speed: float
    theory_gap: float


def lagged_flights(model: str) -> list[Lagged]:
    """Fly three geese over `model` with each of DELAYS, in steps of 1 b / U_min."""
    link = f"{model}:delay=" + "/".join(map(str, DELAYS))
    configuration = FlockConfiguration(birds=3, t_max=T_STEADY, record_every=10, links=(link,))
    states = list(Monolith(configuration).fly())
    speed = np.array([state.speed for state in states])
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
            Lagged(
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


def lagged_table(flights: Sequence[Lagged]) -> Table:
    """Return the flights, one a row."""
    columns = (
        "model",
        "delay_steps",
        "lag_b_per_U_min",
        "speed_U_min",
        "tail_gap_b",
        "swing_of_gap_b",
        "settling_time_b_per_U_min",
        "theory_speed_U_min",
        "theory_gap_b",
    )
    return Table(columns, [tuple(vars(flight).values()) for flight in flights])


@dataclass(frozen=True)
class Held:
    """The span ratios of one bird with which a flock stays together over some links."""

    model: str
    key: str
    value: float
    kept: tuple[float, ...]
    """Those of SPAN_RATIOS, without a gap, around 1; none where equals part, too."""

    @property
    def age(self) -> float:
        """How old what the birds know is on average, in steps of 1 b / U_min."""
        if self.key == "delay":
            return self.value + 0.5
        return 0.5 * self.value if self.key == "interval" else 0.5 + self.value / (1.0 - self.value)


def held(model: str, key: str, value: float) -> Held:
    """Fly seven birds, one modified, over links of `model` with `key` = `value`.

    They stay together if their streamwise extent, a mean over a tenth of the flight, grows by less
    than 1e-4 U_min from half of it to the end: as the paper's criterion, but for noise.
    """
    ratios = SPAN_RATIOS[model]
    configuration = FlockConfiguration(
        birds=BIRDS,
        t_max=T_LIMITS,
        record_every=100,
        span_ratios=(f"{MODIFIED}=" + ",".join(map(repr, ratios)),),
        links=(f"{model}:{key}={value:g}",),
    )
    extent = np.array([np.ptp(state.position, axis=0) for state in Monolith(configuration).fly()])
    ends = _mean_about(extent, 0.5), _mean_about(extent, 0.95)
    with np.errstate(invalid="ignore"):
        together = (ends[1] - ends[0]) / (0.45 * T_LIMITS) < STABLE_BELOW
    return Held(model, key, value, _around_one(ratios, together))


def _mean_about(extent: FloatArray, part: float) -> FloatArray:
    """Return the mean over a tenth of all rows, about `part` of them."""
    rows = len(extent)
    return np.asarray(extent[int((part - 0.05) * rows) : int((part + 0.05) * rows)].mean(axis=0))


def _around_one(ratios: Sequence[float], together: BoolArray) -> tuple[float, ...]:
    """Return the ratios next to each other, 1 among them, of those that are `together`."""
    one = ratios.index(1.0)
    if not together[one]:
        return ()
    apart = np.flatnonzero(~together).tolist()
    first = max((k + 1 for k in apart if k < one), default=0)
    last = min((k for k in apart if k > one), default=len(ratios))
    return tuple(ratios[first:last])


def late_limits(lag: float) -> tuple[float, float]:
    """Return between which ratios the flock has a steady state if all hold what is `lag` old."""
    configuration = FlockConfiguration(birds=BIRDS)

    def flies(ratio: float) -> bool:
        column = np.ones((BIRDS, 1))
        column[MODIFIED - 1] = ratio
        return bool(np.isfinite(lagged_chain(Flock.of(configuration, column), lag).speed))

    def end(inside: float, outside: float) -> float:
        while abs(outside - inside) > 1e-6:
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if flies(middle) else (inside, middle)
        return inside

    return end(1.0, 0.5), end(1.0, 1.5)


def limits_over_links(show: Callable[[float], None]) -> Iterator[Held]:
    """Look for the limits at all of FAULTS; `show` is told of each that is found."""
    asked = [
        (model, key, value)
        for model, keys in FAULTS.items()
        for key, values in keys.items()
        for value in values
    ]
    with workers(None) as crew:
        for found in crew.executor.map(lambda what: held(*what), asked):
            show(1)
            yield found


def held_table(limits: Sequence[Held]) -> Table:
    """Return the limits, those of one link a row."""
    rows: list[Sequence[object]] = [
        (
            found.model,
            found.key,
            found.value,
            min(found.kept, default=None),
            max(found.kept, default=None),
        )
        for found in limits
    ]
    return Table(("model", "key", "value", "lower_span_ratio", "upper_span_ratio"), rows)
