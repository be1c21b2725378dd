# SPDX-License-Identifier: Apache-2.0
"""The key `span_ratios`: the birds that differ from the standard one, as text and as an array."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from flock_sim.errors import FlockError

if TYPE_CHECKING:
    from flock_sim.physics.arrays import FloatArray

FORM = "I=LAMBDA[,LAMBDA...]"
EXAMPLE = "4=1.05"

MOST_WINGS = 10_000_000
"""Largest product of birds and members: an array of one number for each has 80 MB then."""


def array(entries: Iterable[str], birds: int) -> FloatArray:
    """Return lambda of shape (birds, members) from entries "I=LAMBDA[,LAMBDA...]".

    Birds without an entry have 1. Raises FlockError on an entry that can't be read, on a bird or a
    ratio out of range, and on neighbours whose vortices would meet.
    """
    import numpy as np  # which the options of a tool don't need

    given: dict[int, tuple[str, list[float]]] = {}
    for entry in entries:
        bird, ratios = _entry(entry, birds)
        if bird in given:
            raise FlockError(
                f"span ratio {entry!r}: bird {bird} is given twice, also as {given[bird][0]!r}"
            )
        given[bird] = (entry, ratios)

    members = max((len(ratios) for _, ratios in given.values()), default=1)
    check_size(birds, members)
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


def check_size(birds: int, members: int) -> None:
    """Raise FlockError if so many members of a flock are too many for the memory."""
    if birds * members > MOST_WINGS:
        raise FlockError(
            f"{birds} birds x {members} members: must be {MOST_WINGS} wings or less; fly fewer "
            "members at once"
        )


def entries(span_ratio: FloatArray) -> tuple[str, ...]:
    """Return the entries that `array` reads as `span_ratio`, shape (birds, members)."""
    return tuple(
        f"{bird}={','.join(map(repr, ratios.tolist()))}"
        for bird, ratios in enumerate(span_ratio, 1)
    )


def parted(entry: str) -> tuple[int, str]:
    """Return the bird of an entry, and the text of its ratios. Raises ValueError if it has none."""
    bird, _, ratios = entry.partition("=")
    return int(bird), ratios


def _entry(entry: str, birds: int) -> tuple[int, list[float]]:
    try:
        bird, values = parted(entry)
        ratios = [float(value) for value in values.split(",")]
    except ValueError:
        raise FlockError(
            f"span ratio {entry!r}: must be I=LAMBDA or I=LAMBDA,LAMBDA,... such as {EXAMPLE}"
        ) from None
    if not 1 <= bird <= birds:
        raise FlockError(f"span ratio {entry!r}: bird {bird} is not among 1..{birds}")
    for ratio in ratios:
        if not (math.isfinite(ratio) and ratio > 0.0):
            raise FlockError(f"span ratio {entry!r}: {ratio:g} must be finite and above 0")
    return bird, ratios


def _check_wings_apart(ratio: FloatArray) -> None:
    """Refuse neighbours whose bound vortices meet: dy <= a_i + a_j if their lambdas sum to <= 1."""
    meet = ratio[:-1] + ratio[1:] <= 1.0
    for bird, member in zip(*meet.nonzero(), strict=True):
        raise FlockError(
            f"span ratios {ratio[bird, member]:g} and {ratio[bird + 1, member]:g} of birds "
            f"{bird + 1} and {bird + 2}: must sum to more than 1, or their vortices would meet"
        )
