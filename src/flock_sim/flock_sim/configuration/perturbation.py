# SPDX-License-Identifier: Apache-2.0
"""Pushes: changes of position and speed of one bird of one member at the beginning of a step.

A push is added to position and speed before anything is computed or recorded at its step. So the
state recorded at this step includes the push. Several pushes at one step are added in the order in
which they were given. As text a push is BIRD[:MEMBER]@STEP=DPOSITION[,DSPEED].
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from flock_sim.errors import FlockError

if TYPE_CHECKING:
    from flock_sim.physics.arrays import FloatArray

FORM = "BIRD[:MEMBER]@STEP=DPOSITION[,DSPEED]"
EXAMPLE = "4@500=0.1,-0.01"

LONGEST_NUMBER = 20
"""Most digits that are shown of a refused number."""


@dataclass(frozen=True)
class Perturbation:
    """A push of one bird of one member; both are counted from 1."""

    step: int
    """The push happens at the beginning of this step."""
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
        """Change position (b) and speed (U_min) of the bird in place, both of shape (members,)."""
        at = self.member - 1
        # Python's floats give the same bits, without numpy's warning on overflow.
        position[at] = float(position[at]) + self.position
        speed[at] = float(speed[at]) + self.speed

    def check(self, birds: int, members: int, steps: int, told: str = "") -> None:
        """Raise FlockError unless a flight of `steps` steps has this bird, member and step.

        `told` is the original text of the push, if it differs from that of `str`.
        """
        called = f"perturbation {told or str(self)!r}"
        for name, value, least, most in (
            ("bird", self.bird, 1, birds),
            ("member", self.member, 1, members),
            ("step", self.step, 0, steps),
        ):
            if not least <= value <= most:
                said = str(value)
                said = said if len(said) <= LONGEST_NUMBER else f"{said[:LONGEST_NUMBER]}..."
                raise FlockError(f"{called}: {name} {said} is not among {least}..{most}")
        for change in (self.position, self.speed):
            if not math.isfinite(change):
                raise FlockError(f"{called}: {change:g} must be finite")


def perturbations(
    entries: Iterable[str], birds: int, members: int, steps: int
) -> tuple[Perturbation, ...]:
    """Return the pushes in the texts `entries`, in order; without a member, one for each member.

    Raises FlockError on a text that is no push, or names a bird, member or step out of range.
    """
    return tuple(push for entry in entries for push in _read(entry, birds, members, steps))


def in_order(pushes: Iterable[Perturbation]) -> list[Perturbation]:
    """Return `pushes` ordered by step, bird and member; equal ones keep their given order.

    With one order, every process that adds the same pushes gets the same bits.
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
    """Return a whole number, also if it is written as 1e3; raises ValueError otherwise."""
    try:
        return int(text)
    except ValueError:
        value = float(text)
        if not value.is_integer():
            raise
        return int(value)
