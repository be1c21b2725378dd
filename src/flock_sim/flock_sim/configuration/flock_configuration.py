# SPDX-License-Identifier: Apache-2.0
"""The configuration of a flight, which every node and tool reads.

`FlockConfiguration.from_parameters` reads the values of flags, a ROS 2 parameter file and ROS
parameters alike, so a value has the same meaning, and the same error messages, in all of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

from flock_sim.configuration import perturbation
from flock_sim.configuration import span_ratios as ratios
from flock_sim.configuration.choices import COUPLINGS
from flock_sim.configuration.key import Key, told
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.errors import FlockError, nearest
from flock_sim.forcing import settings as forcing_text
from flock_sim.forcing.forcing_table import ForcingTable
from flock_sim.forcing.registry import BUILT_IN
from flock_sim.links import keys

if TYPE_CHECKING:
    from flock_sim.links.link_table import LinkTable
    from flock_sim.physics.arrays import FloatArray

# Largest relative distance of t_max / dt from a whole number: decimals such as 1000 / 0.01 have
# rounding errors.
STEP_TOLERANCE = 1e-12

MOST_BIRDS = 20000
"""Largest flock for which the topics of a bag can be numbered."""

LEAST_ROW = 2.0
"""Shortest time between recorded states, in ns: their stamps must differ."""

LAST_SECOND = float(1 << 31)
"""First time that the 32 bits of a ROS time stamp can't hold, in s."""


def _key(default: Any, meaning: str, unit: str = "1", **facts: Any) -> Any:
    """Return the field of a key; `facts` are the other arguments of `Key`."""
    return field(default=default, metadata={"key": Key(default, meaning, unit, **facts)})


@dataclass(frozen=True)
class FlockConfiguration:
    """A flock and its flight. Defaults: thirteen Canada geese.

    Units are those of the configuration file: b / U_min for `dt` and `t_max`, SI for the bird.
    Raises FlockError on a value that is out of range.
    """

    birds: int = _key(13, "number of birds N", most=MOST_BIRDS)
    coupling: str = _key(
        COUPLINGS[0],
        "which birds act on a bird",
        note="its nearest neighbours, or all others",
        choices=COUPLINGS,
    )
    dt: float = _key(1.0, "step size", "b/U_min")
    t_max: float = _key(10000.0, "flight time", "b/U_min", note="a whole number of steps")
    record_every: int = _key(10, "steps between recorded states")
    body_mass: float = _key(3.8, "mass of the standard bird", "kg")
    wing_span: float = _key(1.5, "full wing span of the standard bird", "m", symbol="2b")
    air_density: float = _key(1.225, "air density", "kg/m^3")
    min_drag_speed: float = _key(
        18.0, "speed of least drag of the standard bird", "m/s", symbol="U_min"
    )
    cruise_speed: float = _key(
        18.5, "solo cruising speed of the standard bird", "m/s", symbol="U_0"
    )
    oswald_efficiency: float = _key(0.8, "Oswald efficiency", symbol="e_O")
    zero_lift_drag: float = _key(0.025, "zero-lift drag coefficient", symbol="C_D")
    aspect_ratio: float = _key(9.0, "aspect ratio", symbol="AR = (2b)^2 / S")
    span_ratios: tuple[str, ...] = _key(
        (),
        "wing span of bird I over the standard span; each of several values makes a member, "
        "an independent flock of the same flight",
        form=ratios.FORM,
        example=ratios.EXAMPLE,
    )
    perturbations: tuple[str, ...] = _key(
        (),
        "push of a bird at the beginning of a step",
        note="change its position, in b, and speed, in U_min, in one member or all",
        form=perturbation.FORM,
        example=perturbation.EXAMPLE,
    )
    links: tuple[str, ...] = _key(
        (),
        "link model for all birds, or for what TARGET knows of SOURCE",
        note="of several for one link, the last one applies",
        form=keys.FORM,
        example=keys.EXAMPLE,
    )
    forcing: tuple[str, ...] = _key(
        (),
        "force besides thrust and drag on all birds, or on BIRD; several add up",
        note=f"MODEL is one of {', '.join(BUILT_IN)}, FILE.py:LAW, or an installed law",
        form=forcing_text.FORM,
        example=forcing_text.EXAMPLE,
    )

    @classmethod
    def given(cls, parameters: Mapping[str, Any]) -> FlockConfiguration:
        """Do the same as `from_parameters` with values of the user.

        Load the laws, and the link models of installed packages, that they name. Raises FlockError
        if one can't be loaded or compiled, or has a bad parameter.
        """
        links = parameters.get("links", ())
        if isinstance(links, Iterable) and not isinstance(links, str):
            from flock_sim.links.installed import load

            load(entry for entry in links if isinstance(entry, str) and entry)
        configuration = cls.from_parameters(parameters)
        configuration.load_laws()
        return configuration

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Any]) -> FlockConfiguration:
        """Return the configuration with `parameters` in place of the defaults.

        Values may have the declared type, or be text that can be read as this type ("1e4").
        Raises FlockError on an unknown key, naming the nearest known one, and on a bad value.
        """
        for key in parameters:
            if key not in KEYS:
                raise FlockError(f"unknown parameter {key!r}: {nearest(key, KEYS)}")
        return cls(**{key: KEYS[key].read(key, value) for key, value in parameters.items()})

    def __post_init__(self) -> None:
        """Refuse a configuration that cannot be flown."""
        for name, key in KEYS.items():
            key.check(name, getattr(self, name))
        links = tuple(map(keys.with_arrow, self.links))
        object.__setattr__(self, "links", links)  # so that equal flocks have equal text
        if self.cruise_speed < self.min_drag_speed:
            raise FlockError(
                f"cruise_speed = {self.cruise_speed:g}: must be min_drag_speed "
                f"({told(self.min_drag_speed)} m/s) or more"
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
                f"t_max = {told(self.t_max)}: must be below {latest:.6g}, the largest time "
                "that ROS can represent"
            )
        if self.record_every * self.dt * self.second * 1e9 < LEAST_ROW:
            raise FlockError(
                f"dt = {self.dt:g} and record_every = {self.record_every}: states are recorded "
                f"less than {LEAST_ROW:g} ns apart; raise one of them"
            )
        if not _whole_steps(self.t_max, self.dt):
            raise FlockError(
                f"t_max = {told(self.t_max)}: must be a multiple of dt = {told(self.dt)}; "
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
        ratio = ratios.array(self.span_ratios, self.birds)
        members, told = ratio.shape[1], "span_ratios have"
        for others, entry in (
            (self.link_table.members, f"link {self.link_table.longest!r}"),
            (self.forcing_table.members, f"forcing {self.forcing_table.longest!r}"),
        ):
            if members == 1 and others > 1:
                ratios.check_size(self.birds, others)
                ratio, members, told = ratio.repeat(others, axis=1), others, f"{entry} has"
            elif others not in (1, members):
                raise FlockError(
                    f"{entry} has {others} members and {told} {members}: give 1 or {members} to "
                    "every link and forcing"
                )
        return ratio

    @cached_property
    def link_table(self) -> LinkTable:
        """The links of the flock: how every bird knows its neighbours."""
        # Imported here, as it needs numpy, which the options of a tool don't need.
        from flock_sim.links.link_table import LinkTable

        return LinkTable(self.links, self.birds, self.coupling)

    @cached_property
    def forcing_table(self) -> ForcingTable:
        """The forces besides thrust and drag. Laws of one's own are not loaded by reading it."""
        return ForcingTable(self.forcing, self.birds)

    def load_laws(self) -> None:
        """Load the laws of one's own that `forcing` names, and check all values.

        Raises FlockError if that fails. Call it for a configuration that the user has given, never
        for one from a bag or a message: it runs the files that the configuration names.
        """
        if self.forcing:
            from flock_sim.forcing.own_laws import load

            load(self.forcing_table.names)
            self.forcing_table.check()

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

    def steps_averaged(self, step: int) -> int:
        """Return how many steps, `step` included, the means in the state at `step` are over."""
        return 1 + (step - 1) % self.record_every if step else 1

    def parameters(self) -> dict[str, Any]:
        """Return every key of the configuration file with its value."""
        values = {name: getattr(self, name) for name in KEYS}
        return {**values, **{name: list(values[name]) for name in LISTS}}


KEYS: Mapping[str, Key] = {one.name: one.metadata["key"] for one in fields(FlockConfiguration)}

LISTS = tuple(name for name, key in KEYS.items() if key.form)
"""The keys whose values are lists."""

MEANING = {
    name: f"{key.text}; each as {key.form}" if key.form else key.text for name, key in KEYS.items()
}
"""The meaning of each key, in full."""


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
