# SPDX-License-Identifier: Apache-2.0
"""Pushes: what one bird of one member is moved and sped up by at the beginning of a step.

Before anything is computed or recorded there, the push is added to position and speed, so the state
that is recorded at that step is the one after it. Several at one step are added in the order in
which they were given. As text a push is BIRD[:MEMBER]@STEP=DPOSITION[,DSPEED].
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from flock_sim.core.kernel import FloatArray
from flock_sim.errors import FlockError

FORM = "BIRD[:MEMBER]@STEP=DPOSITION[,DSPEED]"
EXAMPLE = "4@500=0.1,-0.01"


@dataclass(frozen=True)
class Perturbation:
    """A push of one bird of one member; both are counted from 1."""

    step: int
    """The step at whose beginning it happens."""
    bird: int
    member: int
    position: float
    """Change of position, in b."""
    speed: float
    """Change of speed, in U_min."""

    def __str__(self) -> str:
        change = f"{self.position!r},{self.speed!r}"
        return f"{self.bird}:{self.member}@{self.step}={change}"

    def push(self, position: FloatArray, speed: FloatArray) -> None:
        """Change in place position (b) and speed (U_min) of the bird, both of shape (members,)."""
        at = self.member - 1
        # Python's own numbers: the same bits, and no complaint where a push is beyond all numbers.
        position[at] = float(position[at]) + self.position
        speed[at] = float(speed[at]) + self.speed

    def check(self, birds: int, members: int, steps: int, told: str = "") -> None:
        """Raise FlockError unless a flight of `steps` steps has such a bird, member and step.

        `told` is how it was written, where it was not as `str` writes it.
        """
        called = f"perturbation {told or str(self)!r}"
        for name, value, least, most in (
            ("bird", self.bird, 1, birds),
            ("member", self.member, 1, members),
            ("step", self.step, 0, steps),
        ):
            if not least <= value <= most:
                raise FlockError(f"{called}: {name} {value} is not among {least}..{most}")
        for change in (self.position, self.speed):
            if not math.isfinite(change):
                raise FlockError(f"{called}: {change:g} must be finite")


def perturbations(
    entries: Iterable[str], birds: int, members: int, steps: int
) -> tuple[Perturbation, ...]:
    """Return the pushes that texts ask of a flight, in order: of all members if none is named.

    Raises FlockError on a text that is none, or asks for what the flight has not.
    """
    return tuple(push for entry in entries for push in _read(entry, birds, members, steps))


def in_order(pushes: Iterable[Perturbation]) -> list[Perturbation]:
    """Return `pushes` by step, bird and member, and then in the order in which they were given.

    Whoever adds the same ones in this order gets the same bits.
    """
    return sorted(pushes, key=lambda push: (push.step, push.bird, push.member))


def _read(entry: str, birds: int, members: int, steps: int) -> Iterator[Perturbation]:
    whom, _, rest = entry.partition("@")
    when, _, changes = rest.partition("=")
    bird, colon, member = whom.partition(":")
    position, comma, speed = changes.partition(",")
    try:
        number = int(bird)
        which = (int(member),) if colon else range(1, members + 1)
        step = _whole(when)
        change = float(position), float(speed) if comma else 0.0
    except ValueError:
        raise FlockError(f"perturbation {entry!r}: must be {FORM} such as {EXAMPLE}") from None
    for one in which:
        push = Perturbation(step, number, one, *change)
        push.check(birds, members, steps, entry)
        yield push


def _whole(text: str) -> int:
    """Return a whole number, also where it is written as 1e3; raises ValueError otherwise."""
    try:
        return int(text)
    except ValueError:
        value = float(text)
        if not value.is_integer():
            raise
        return int(value)
