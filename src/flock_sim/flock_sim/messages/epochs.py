# SPDX-License-Identifier: Apache-2.0
"""Epochs: their order, their successor, and how far ahead a new epoch is accepted.

An epoch is a 32-bit serial number. Each rewind takes the next one, and 1 follows the last. An
epoch is later than another if it is fewer than 2^31 ahead (the serial number order of RFC 1982), so
nothing overflows. Epochs of genuine messages lie close together. An epoch out of reach, either way,
comes from a message that no node of the flight has sent.

A clock draws its first epoch at random from REACH numbers, so that a restarted clock is not
confused with the previous one. If the previous clock had reached later epochs, the birds and the
recorder report them in their progress, and the new clock goes beyond them. It receives the oldest
reports first, so the epoch after a reported one may be one that the previous clock has begun. It
takes one of the next CLOCKS epochs, determined by its first one. The time of day of a computer is
not used.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable

EPOCHS = 2**32
"""Number of values of an epoch, which has 32 bits in messages."""

NEVER = -1
"""Epoch of a node that has not joined an epoch."""

REACH = 2**20
"""Largest distance between epochs of genuine messages. To move further takes two messages."""

CLOCKS = 2**12
"""Number of epochs among which a new clock takes one, after an epoch of the previous clock."""


def first_epoch() -> int:
    """Return the first epoch of a clock."""
    return 1 + secrets.randbelow(REACH)


def ahead(epoch: int, present: int) -> int:
    """Return by how many epochs `epoch` is later than `present`; negative if it is earlier.

    Every epoch is later than NEVER.
    """
    if present == NEVER:
        return 1
    difference = (epoch - present) % EPOCHS
    return difference if difference < EPOCHS // 2 else difference - EPOCHS


def out_of_reach(epoch: int, present: int) -> bool:
    """Whether `epoch` is more than REACH before or after `present`; False if that is NEVER."""
    return abs(ahead(epoch, present)) > REACH


def out_of_date(epoch: int, present: int) -> bool:
    """Whether `epoch` is one of the REACH epochs before `present`."""
    return -REACH <= ahead(epoch, present) < 0


def in_order(epochs: Iterable[int]) -> list[int]:
    """Return `epochs` from the earliest to the latest; all are less than 2^31 from the first."""
    given = list(epochs)
    return sorted(given, key=lambda epoch: ahead(epoch, given[0]))


def following(epoch: int) -> int:
    """Return the epoch after `epoch`. 0 is not an epoch: in messages it means "no push"."""
    return (epoch + 1) % EPOCHS or 1


def beyond(epoch: int, first: int) -> int:
    """Return where a clock goes on that began with epoch `first`, and hears of a later `epoch`.

    It is the next epoch that equals `first` modulo CLOCKS: two clocks rarely take the same one.

    >>> beyond(9, first=5), beyond(10_000, first=5)
    (4101, 12293)
    """
    return following(epoch + (first - epoch - 1) % CLOCKS)


def before(epoch: int) -> int:
    """Return the epoch before `epoch`."""
    return (epoch - 1) % EPOCHS or EPOCHS - 1
