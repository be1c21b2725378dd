# SPDX-License-Identifier: Apache-2.0
"""The configuration of a flight, which every node and tool reads.

`FlockConfiguration.from_parameters` reads the values of flags, a ROS 2 parameter file and ROS
parameters alike, so a value has the same meaning, and the same error messages, in all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from flock_sim.configuration import perturbation
from flock_sim.configuration.choices import COUPLINGS
from flock_sim.configuration.parameter import Parameter
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.errors import FlockError, nearest
from flock_sim.links import keys
from flock_sim.links.link_table import LinkTable
from flock_sim.physics.arrays import FloatArray

# Largest relative distance of t_max / dt from a whole number: decimals such as 1000 / 0.01 have
# rounding errors.
STEP_TOLERANCE = 1e-12

MOST_BIRDS = 20000
"""Largest flock for which the topics of a bag can be numbered."""

LEAST_ROW = 2.0
"""Shortest time between recorded states, in ns: their stamps must differ."""

LAST_SECOND = 2.0**31
"""First time that the 32 bits of a ROS time stamp can't hold, in s."""

LONGEST_VALUE = 60
"""Most characters that are shown of a refused value."""

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
    "links": f"how birds know their neighbours, each as {keys.FORM}",
}

LIMITS: dict[str, dict[str, Any]] = {
    "birds": {"most": MOST_BIRDS},
    "coupling": {"choices": COUPLINGS},
    "record_every": {"most": 2**53},
}

EXAMPLES = {
    "span_ratios": "4=1.05",
    "perturbations": perturbation.EXAMPLE,
    "links": keys.EXAMPLE,
}
"""An example of an entry of each list."""


@dataclass(frozen=True)
class FlockConfiguration:
    """A flock and its flight. Defaults: thirteen Canada geese.

    Units are those of the configuration file: b / U_min for `dt` and `t_max`, SI for the bird.
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

        Values may have the declared type, or be text that can be read as this type ("1e4").
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
        """Refuse a configuration that cannot be flown."""
        for name in ("birds", "record_every"):
            value, most = getattr(self, name), LIMITS[name]["most"]
            if value < 1:
                raise FlockError(f"{name} = {_told(value)}: must be 1 or more")
            if value > most:
                raise FlockError(f"{name} = {_told(value)}: must be {most} or less")
        if self.coupling not in COUPLINGS:
            raise FlockError(f"coupling = {self.coupling!r}: {nearest(self.coupling, COUPLINGS)}")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type == "float" and not (math.isfinite(value) and value > 0.0):
                raise FlockError(f"{field.name} = {value:g}: must be finite and above 0")
        if self.cruise_speed < self.min_drag_speed:
            raise FlockError(
                f"cruise_speed = {self.cruise_speed:g}: must be min_drag_speed "
                f"({_told(self.min_drag_speed)} m/s) or more"
            )
        self._check_time()
        self.span_ratio, self.pushes  # noqa: B018  (read once, so that bad ones are refused here)

    def _check_time(self) -> None:
        """Refuse a flight time that is not a whole number of steps, or exceeds ROS time."""
        steps = self.t_max / self.dt
        if math.isinf(steps):
            raise FlockError(
                f"t_max = {self.t_max:g} and dt = {self.dt:g}: too many steps to count; "
                "give a larger dt"
            )
        if not self._in_ros_time(max(self.t_max, self.time(self.steps))):
            latest = LAST_SECOND / self.second * (1.0 - 5e-6)  # rounded to six digits still below
            raise FlockError(
                f"t_max = {_told(self.t_max)}: must be below {latest:.6g}, where the seconds of "
                "ROS time end"
            )
        if self.record_every * self.dt * self.second * 1e9 < LEAST_ROW:
            raise FlockError(
                f"dt = {self.dt:g} and record_every = {self.record_every}: states are recorded "
                f"less than {LEAST_ROW:g} ns apart; raise one of them"
            )
        if not _whole_steps(self.t_max, self.dt):
            raise FlockError(
                f"t_max = {_told(self.t_max)}: must be a multiple of dt = {_told(self.dt)}; "
                f"{self._multiples(math.floor(steps))}"
            )

    def _in_ros_time(self, time: float) -> bool:
        """Whether a time, in b / U_min, fits into a ROS time stamp."""
        return time * self.second < LAST_SECOND

    def _multiples(self, steps: int) -> str:
        """Return text on the accepted flight times near `steps` steps, with few digits.

        The digits must suffice: the printed times must pass the check that prints them.
        """
        around = (max(1, steps), max(1, steps) + 1)
        fit = [_digits(k, self.dt) for k in around if self._in_ros_time(self.time(k))]
        return f"{' and '.join(fit)} {'are' if len(fit) > 1 else 'is'}" if fit else "lower dt"

    @cached_property
    def span_ratio(self) -> FloatArray:
        """lambda_i of every bird and member, shape (birds, members)."""
        ratio = _span_ratio(self.span_ratios, self.birds)
        members, others = ratio.shape[1], self.link_table.members
        if members == 1:
            return np.repeat(ratio, others, axis=1)
        if others not in (1, members):
            raise FlockError(
                f"link {self.link_table.longest!r} has {others} members and span_ratios have "
                f"{members}: give 1 or {members} to every link"
            )
        return ratio

    @cached_property
    def link_table(self) -> LinkTable:
        """The links of the flock: how every bird knows its neighbours."""
        return LinkTable(self.links, self.birds, self.coupling)

    @cached_property
    def pushes(self) -> tuple[Perturbation, ...]:
        """The perturbations in the given order, one for each pushed member."""
        return perturbation.perturbations(self.perturbations, self.birds, self.members, self.steps)

    @property
    def members(self) -> int:
        """Number M of independent flocks that fly at once."""
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


KEYS = {
    field.name: Parameter(field.default, MEANING[field.name], **LIMITS.get(field.name, {}))
    for field in fields(FlockConfiguration)
}
"""The keys of the configuration file."""


def _whole_steps(t_max: float, dt: float) -> bool:
    """Whether a flight time is a whole number of steps, apart from the rounding of decimals."""
    steps = t_max / dt
    return round(steps) >= 1 and abs(steps - round(steps)) <= STEP_TOLERANCE * steps


def _digits(steps: int, dt: float) -> str:
    """Return the shortest text of the time of `steps` steps that reads as this number of steps."""
    for digits in range(6, 17):
        text = f"{steps * dt:.{digits}g}"
        if _whole_steps(float(text), dt) and round(float(text) / dt) == steps:
            return text
    return repr(steps * dt)


def _told(value: float) -> str:
    """Return the shortest text of a number that reads as this number."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


def _whole(key: str, value: Any) -> int:
    number = _real(key, value)
    if not math.isfinite(number) or number != math.floor(number):
        raise FlockError(f"{key} = {_shown(value)}: must be a whole number")
    return int(number)


def _real(key: str, value: Any) -> float:
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            return float(value)
        except (ValueError, OverflowError):
            pass
    raise FlockError(f"{key} = {_shown(repr(value))}: must be a number")


def _shown(value: object) -> str:
    """Return the shown part of a refused value, which may have any length."""
    text = str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


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
    """Refuse neighbours whose bound vortices meet: dy <= a_i + a_j if their lambdas sum to <= 1."""
    sums = ratio[:-1] + ratio[1:]
    if np.any(sums <= 1.0):
        bird, member = (int(k) for k in np.argwhere(sums <= 1.0)[0])
        raise FlockError(
            f"span ratios {ratio[bird, member]:g} and {ratio[bird + 1, member]:g} of birds "
            f"{bird + 1} and {bird + 2}: must sum to more than 1, or their vortices would meet"
        )
