# SPDX-License-Identifier: Apache-2.0
"""What is flown: the one configuration that every node and tool reads.

Flags, a ROS 2 parameter file and ROS parameters all end in `FlockConfiguration.from_parameters`,
so a value means the same, and is refused with the same words, wherever it was written.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from flock_sim.core import perturbation
from flock_sim.core.kernel import FloatArray
from flock_sim.core.links import settings
from flock_sim.core.links.linkage import Linkage
from flock_sim.core.perturbation import Perturbation
from flock_sim.core.spelling import nearest
from flock_sim.errors import FlockError

COUPLINGS = ("nearest", "all")

# How close t_max / dt must be to a whole number: decimals such as 1000 / 0.01 are off by rounding.
STEP_TOLERANCE = 1e-12

MOST_BIRDS = 20000
"""What the topics of a bag can be numbered for."""

LEAST_ROW = 2.0
"""Least time between recorded states, in ns: their stamps must differ."""

LAST_SECOND = 2.0**31
"""What the 32 bits of a ROS time stamp can't hold any more, in s."""

MEANING = {
    "birds": "number of birds N",
    "coupling": "whom a bird feels: its nearest neighbours, or all others",
    "dt": "step size, in b / U_min",
    "t_max": "flight time, in b / U_min: a whole number of steps",
    "record_every": "steps between recorded states",
    "body_mass": "mass of the standard bird, in kg",
    "wing_span": "full wing span 2b of the standard bird, in m",
    "air_density": "in kg/m^3",
    "min_drag_speed": "speed of least drag U_min of the standard bird, in m/s",
    "cruise_speed": "solo cruising speed U_0 of the standard bird, in m/s",
    "oswald_efficiency": "Oswald efficiency e_O",
    "zero_lift_drag": "zero-lift drag coefficient C_D",
    "aspect_ratio": "aspect ratio AR = (2b)^2 / S",
    "span_ratios": "birds that differ, each as I=LAMBDA or I=LAMBDA,LAMBDA,... (one a member)",
    "perturbations": f"pushes, each as {perturbation.FORM}, in b and U_min",
    "links": f"how birds know their neighbours, each as {settings.FORM}",
}

EXAMPLES = {
    "span_ratios": "4=1.05",
    "perturbations": perturbation.EXAMPLE,
    "links": settings.EXAMPLE,
}
"""What the entries of a list look like."""


@dataclass(frozen=True)
class FlockConfiguration:
    """A flock and its flight. Defaults: thirteen Canada geese.

    Units are those of the configuration file: `dt` and `t_max` in b / U_min, the bird in SI.
    Raises FlockError on a value that is out of range.
    """

    birds: int = 13
    coupling: str = "nearest"
    dt: float = 1.0
    t_max: float = 10000.0
    record_every: int = 10
    body_mass: float = 3.8
    wing_span: float = 1.5
    air_density: float = 1.225
    min_drag_speed: float = 18.0
    cruise_speed: float = 18.5
    oswald_efficiency: float = 0.8
    zero_lift_drag: float = 0.025
    aspect_ratio: float = 9.0
    span_ratios: tuple[str, ...] = ()
    perturbations: tuple[str, ...] = ()
    links: tuple[str, ...] = ()

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Any]) -> FlockConfiguration:
        """Return the configuration with `parameters` in place of the defaults.

        Values may be of the declared type or text that reads as it ("1e4").
        Raises FlockError on an unknown key, naming the nearest known one, and on a bad value.
        """
        known = {field.name: field for field in fields(cls)}
        for key in parameters:
            if key not in known:
                raise FlockError(f"unknown parameter {key!r}: {nearest(key, known)}")
        readers: dict[str, Callable[[str, Any], Any]]
        readers = {"int": _whole, "float": _real, "str": _text, "tuple[str, ...]": _texts}
        return cls(
            **{key: readers[str(known[key].type)](key, value) for key, value in parameters.items()}
        )

    def __post_init__(self) -> None:
        """Refuse what cannot be flown."""
        for name, most in (("birds", MOST_BIRDS), ("record_every", 2**53)):
            value = getattr(self, name)
            if value < 1:
                raise FlockError(f"{name} = {value}: must be 1 or more")
            if value > most:
                raise FlockError(f"{name} = {value}: must be {most} or less")
        if self.coupling not in COUPLINGS:
            raise FlockError(f"coupling = {self.coupling!r}: {nearest(self.coupling, COUPLINGS)}")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type == "float" and not (math.isfinite(value) and value > 0.0):
                raise FlockError(f"{field.name} = {value:g}: must be finite and above 0")
        if self.cruise_speed < self.min_drag_speed:
            raise FlockError(
                f"cruise_speed = {self.cruise_speed:g}: must be min_drag_speed "
                f"({self.min_drag_speed:g} m/s) or more"
            )
        steps = self.t_max / self.dt
        if math.isinf(steps):
            raise FlockError(
                f"t_max = {self.t_max:g} and dt = {self.dt:g}: too many steps to count; "
                "give a larger dt"
            )
        if round(steps) < 1 or abs(steps - round(steps)) > STEP_TOLERANCE * steps:
            below = max(1, math.floor(steps)) * self.dt
            raise FlockError(
                f"t_max = {self.t_max:g}: must be a multiple of dt = {self.dt:g}; "
                f"{below:.12g} and {below + self.dt:.12g} are"
            )
        if self.time(self.steps) * self.second >= LAST_SECOND:
            raise FlockError(
                f"t_max = {self.t_max:g}: must be below {LAST_SECOND / self.second:.6g}, where "
                "the seconds of ROS time end"
            )
        if self.record_every * self.dt * self.second * 1e9 < LEAST_ROW:
            raise FlockError(
                f"dt = {self.dt:g} and record_every = {self.record_every}: states are recorded "
                f"less than {LEAST_ROW:g} ns apart; raise one of them"
            )
        self.span_ratio, self.pushes  # noqa: B018  (read once, so that bad ones are refused here)

    @cached_property
    def span_ratio(self) -> FloatArray:
        """lambda_i of every bird and member, shape (birds, members)."""
        ratio = _span_ratio(self.span_ratios, self.birds)
        members, others = ratio.shape[1], self.linkage.members
        if members == 1:
            return np.repeat(ratio, others, axis=1)
        if others not in (1, members):
            raise FlockError(
                f"link {self.linkage.longest!r} has {others} members and span_ratios have "
                f"{members}: give 1 or {members} to every link"
            )
        return ratio

    @cached_property
    def linkage(self) -> Linkage:
        """How every bird knows its neighbours."""
        return Linkage(self.links, self.birds, self.coupling)

    @cached_property
    def pushes(self) -> tuple[Perturbation, ...]:
        """The perturbations, in the order in which they are given, one for each member pushed."""
        return perturbation.perturbations(self.perturbations, self.birds, self.members, self.steps)

    @property
    def members(self) -> int:
        """Number M of independent flocks that are flown at once."""
        return int(self.span_ratio.shape[1])

    @property
    def steps(self) -> int:
        """Number of RK4 steps of the flight."""
        return round(self.t_max / self.dt)

    @property
    def second(self) -> float:
        """The unit of time b / U_min, in s."""
        return 0.5 * self.wing_span / self.min_drag_speed

    def time(self, step: int) -> float:
        """Return the time at the beginning of `step`, in b / U_min."""
        return step * self.dt

    def stamp(self, step: int) -> int:
        """Return the simulated time at the beginning of `step`, in ns."""
        return round(self.time(step) * self.second * 1e9)

    def parameters(self) -> dict[str, Any]:
        """Return every key of the configuration file with its value."""
        lists = {key: list(getattr(self, key)) for key in EXAMPLES}
        return {**asdict(self), **lists}


def _whole(key: str, value: Any) -> int:
    number = _real(key, value)
    if not math.isfinite(number) or number != math.floor(number):
        raise FlockError(f"{key} = {value}: must be a whole number")
    return int(number)


def _real(key: str, value: Any) -> float:
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            return float(value)
        except (ValueError, OverflowError):
            pass
    raise FlockError(f"{key} = {value!r}: must be a number")


def _text(key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise FlockError(f"{key} = {value!r}: must be text")
    return value


def _texts(key: str, value: Any) -> tuple[str, ...]:
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise FlockError(f'{key} = {value!r}: must be a list such as ["{EXAMPLES[key]}"]')
    return tuple(_text(key, item) for item in value if item != "")


def _span_ratio(entries: tuple[str, ...], birds: int) -> FloatArray:
    """Return lambda of shape (birds, members) from entries "I=LAMBDA[,LAMBDA...]"."""
    given: dict[int, tuple[str, list[float]]] = {}
    for entry in entries:
        bird, ratios = _entry(entry, birds)
        if bird in given:
            raise FlockError(
                f"span ratio {entry!r}: bird {bird} is given twice, also as {given[bird][0]!r}"
            )
        given[bird] = (entry, ratios)

    members = max((len(ratios) for _, ratios in given.values()), default=1)
    ratio = np.ones((birds, members))
    for bird, (entry, ratios) in given.items():
        if len(ratios) not in (1, members):
            longest = next(e for e, r in given.values() if len(r) == members)
            raise FlockError(
                f"span ratio {entry!r} has {len(ratios)} members and {longest!r} has {members}: "
                f"give 1 or {members} to every bird"
            )
        ratio[bird - 1] = ratios
    _check_wings_apart(ratio)
    return ratio


def _entry(entry: str, birds: int) -> tuple[int, list[float]]:
    number, equals, values = entry.partition("=")
    try:
        bird, ratios = int(number), [float(value) for value in values.split(",")]
    except ValueError:
        equals = ""
    if not equals:
        raise FlockError(
            f"span ratio {entry!r}: must be I=LAMBDA or I=LAMBDA,LAMBDA,... such as 4=1.05"
        )
    if not 1 <= bird <= birds:
        raise FlockError(f"span ratio {entry!r}: bird {bird} is not among 1..{birds}")
    for ratio in ratios:
        if not (math.isfinite(ratio) and ratio > 0.0):
            raise FlockError(f"span ratio {entry!r}: {ratio:g} must be finite and above 0")
    return bird, ratios


def _check_wings_apart(ratio: FloatArray) -> None:
    """Refuse neighbours whose bound vortices would meet: dy = a_i + a_j where lambdas sum to 1."""
    sums = ratio[:-1] + ratio[1:]
    if np.any(sums <= 1.0):
        bird, member = (int(k) for k in np.argwhere(sums <= 1.0)[0])
        raise FlockError(
            f"span ratios {ratio[bird, member]:g} and {ratio[bird + 1, member]:g} of birds "
            f"{bird + 1} and {bird + 2}: must sum to more than 1, or their vortices would meet"
        )
