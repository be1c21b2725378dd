# SPDX-License-Identifier: Apache-2.0
"""Forcing models: forces on a bird besides thrust and drag.

A new model is a law here, or in a file of its own, and a line in `forcing/registry.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from flock_sim.forcing.law import SEED, Bird, Law, Neighbours, signature_of
from flock_sim.model_text import SEED as SEED_KEY
from flock_sim.model_text import NumberKey
from flock_sim.physics.trigonometry import sine_and_cosine

if TYPE_CHECKING:
    from flock_sim.physics.arrays import FloatArray

LONGEST = 1e12
"""Longest correlation time, in b / U_min: more than ROS can count."""

Values = Mapping[str, "FloatArray | None"]
"""The values of the keys, each of shape (members,); None: not given, without a default."""


@dataclass(frozen=True)
class Prepared:
    """The law of a term and its parameters."""

    law: Law
    parameters: Mapping[str, FloatArray]
    """Each of shape (members,)."""
    spread: FloatArray | None = None
    """Standard deviation of the first state number at the start, (members,); None: all are 0."""


@dataclass(frozen=True)
class ForcingModel:
    """A kind of force on a bird."""

    name: str
    """The name as it is written in `forcing`."""
    keys: Mapping[str, NumberKey]
    prepare: Callable[[Values, float, FloatArray], Prepared]
    """(values, dt, mass) -> law and parameters. The mass of the bird has shape (members,)."""
    meaning: str = ""
    digest: str = field(default="", compare=False)
    """The digest of the source of a law of one's own, or ""."""
    optional: tuple[str, ...] = ()
    """Keys without a default that may be left out."""

    @property
    def required(self) -> list[str]:
        """The keys that must be given."""
        without = [key for key, bounds in self.keys.items() if bounds.default is None]
        return [key for key in without if key not in self.optional]


_FINITE = "a finite number", math.isfinite
_POSITIVE = "finite, above 0", lambda v: 0.0 < v < math.inf
_DURATION = f"above 0, {LONGEST:g} or less", lambda v: 0.0 < v <= LONGEST
_SIZE = "finite, 0 or more", lambda v: 0.0 <= v < math.inf


def plain_model(name: str, law: Law, keys: Mapping[str, NumberKey], meaning: str) -> ForcingModel:
    """Return the model of a law whose parameters are the keys."""

    def prepare(values: Values, dt: float, mass: FloatArray) -> Prepared:
        return Prepared(law, _all_but(values))

    return ForcingModel(name, keys, prepare, meaning)


def own_model(name: str, law: Law, digest: str = "") -> ForcingModel:
    """Return the model of a law of one's own, whose parameters may have any finite value.

    Raises FlockError if it can't be a law.
    """
    signature = signature_of(law)
    keys = {
        key: NumberKey(key, "1", *_FINITE, default) for key, default in signature.parameters.items()
    }
    if signature.seeded:
        keys[SEED] = SEED_KEY
    lines = (law.__doc__ or "").strip().splitlines()
    model = plain_model(name, law, keys, lines[0] if lines else "")
    return ForcingModel(name, keys, model.prepare, model.meaning, digest)


def _all_but(values: Values, *optional: str) -> dict[str, FloatArray]:
    """Return the values of all keys but `optional`; settings without one were refused."""
    found = {}
    for key, value in values.items():
        if key not in optional:
            assert value is not None, key
            found[key] = value
    return found


def constant(force: float) -> float:
    """Return a constant force."""
    return force


def sine(time: float, amplitude: float, period: float, phase: float) -> float:
    """Return a force that is a sine of time; `phase` in periods."""
    turns = time / period + phase
    wave, _ = sine_and_cosine(turns - math.floor(turns))
    return amplitude * wave


def keeper(
    bird: Bird, neighbours: Neighbours, gap: float, stiffness: float, damping: float
) -> float:
    """Return a force that keeps a gap to the neighbour next to the bird towards the leader.

    It is stiffness (x - x_j - gap) + damping (U - U_j), with x and U of this neighbour. The leader,
    and a bird that knows nothing of this neighbour, have no such force.
    """
    if bird.number == bird.leader:
        return 0.0
    ahead = bird.number + (1 if bird.number < bird.leader else -1)
    for k in range(len(neighbours.number)):
        if neighbours.number[k] == ahead and neighbours.circulation[k] != 0.0:
            behind = neighbours.position[k] - bird.position
            slower = neighbours.speed[k] - bird.speed
            return float(stiffness * (behind - gap) + damping * slower)
    return 0.0


def white_gust(bird: Bird, noise: FloatArray, scale: float) -> float:
    """Return the force of a white acceleration: over a step its integral is std sqrt(dt) xi."""
    return float(bird.mass * (scale * noise[0]))


def coloured_gust(
    bird: Bird,
    step_state: FloatArray,
    noise: FloatArray,
    rate_by_state: float,
    rate_by_noise: float,
    mean_by_state: float,
    mean_by_noise: float,
    mean_by_other: float,
) -> tuple[float, tuple[float]]:
    """Return the force of an Ornstein-Uhlenbeck acceleration, and the rate of the acceleration.

    The acceleration at the steps, which is the state, and its means over the steps, which are the
    force, have the joint distribution of the continuous process.
    """
    a = step_state[0]
    mean = mean_by_state * a + (mean_by_noise * noise[0] + mean_by_other * noise[1])
    return bird.mass * mean, (rate_by_state * a + rate_by_noise * noise[0],)


def _keeper(values: Values, dt: float, mass: FloatArray) -> Prepared:
    import numpy as np

    given = _all_but(values, "damping")
    damping = values["damping"]
    if damping is None:
        damping = 2.0 * np.sqrt(given["stiffness"] * mass)
    return Prepared(keeper, {**given, "damping": damping})


def _gust(values: Values, dt: float, mass: FloatArray) -> Prepared:
    import numpy as np

    from flock_sim.forcing.ornstein_uhlenbeck import coefficients

    std, time = _all_but(values, "time")["std"], values["time"]
    if time is None:
        return Prepared(white_gust, {"scale": std / math.sqrt(dt)})
    rows = np.array([coefficients(s, tau, dt) for s, tau in zip(std, time, strict=True)]).T
    names = signature_of(coloured_gust).parameters
    return Prepared(coloured_gust, dict(zip(names, rows, strict=True)), std)


CONSTANT = plain_model(
    "constant",
    constant,
    {"force": NumberKey("force", "rho b^2 U_min^2", *_FINITE, None)},
    "a constant force",
)

SINE = plain_model(
    "sine",
    sine,
    {
        "amplitude": NumberKey("amplitude", "rho b^2 U_min^2", *_FINITE, None),
        "period": NumberKey("period", "b/U_min", *_POSITIVE, None),
        "phase": NumberKey("phase at time 0", "periods", *_FINITE),
    },
    "a sine of time",
)

KEEPER = ForcingModel(
    "keeper",
    {
        "gap": NumberKey("distance behind the neighbour", "b", *_FINITE, None),
        "stiffness": NumberKey("force per gap error", "rho b U_min^2", *_SIZE, None),
        "damping": NumberKey(
            "force per relative speed (default: critical)", "rho b^2 U_min", *_SIZE, None
        ),
    },
    _keeper,
    "keeps a gap to the neighbour next to the bird towards the leader",
    optional=("damping",),
)

GUST = ForcingModel(
    "gust",
    {
        "std": NumberKey("strength", "U_min per sqrt(b/U_min); with time U_min^2/b", *_SIZE, None),
        "time": NumberKey("correlation time (default: white)", "b/U_min", *_DURATION, None),
        SEED: SEED_KEY,
    },
    _gust,
    "a random acceleration, white or of a correlation time",
    optional=("time",),
)
