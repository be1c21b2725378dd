# SPDX-License-Identifier: Apache-2.0
"""The words of a bird's forcing: its terms, and where the arrays of its laws are in memory.

Compiled laws get the address of these words, and read and write the arrays that they point to. So
one kernel calls any law, by its address, and no kernel is compiled again for a new law.
"""

from __future__ import annotations

import numpy as np

from flock_sim.physics.arrays import FloatArray, IntArray
from flock_sim.physics.compile import inlined
from flock_sim.physics.compiler import numba
from flock_sim.physics.native_call import pointer

# Numbers of the bird, of the leader, of members, neighbours, state numbers and terms.
BIRD, LEADER, MEMBERS, NEIGHBOURS, STATES, TERMS = range(6)
# Whether a law takes the neighbours; the first link to the bird in the table of all links.
LOOKS, FIRST_LINK = 6, 7
# The fault of a law, its term and its member.
FAULT, FAULT_TERM, FAULT_MEMBER = 8, 9, 10
# The addresses of the arrays below, in this order.
OWN, NOW, NUMBER, LATERAL, NEAR, STATE, START, SLOPES, RATE, FORCE, NOISE = range(11, 22)
# For each term: the addresses of its law and of its parameters, its first state number and their
# number, the address of its seeds (0: it takes no noise), its place among all seeded terms, and
# whether it is Flock's own.
FIRST_TERM = 22
FUNCTION, PARAMETERS, FIRST_STATE, STATES_OF_LAW, SEEDS, ORDINAL, BUILT_IN = range(7)
EACH = 7

# Rows of OWN, shape (6, members): the coefficients of a bird as kernels have them, and its span.
MASS, THRUST = 0, 1
SPAN_RATIO = 5
OWN_ROWS = 6
# Rows of NOW, shape (3, members), and of NEAR, shape (3, members, neighbours).
POSITION, SPEED, CIRCULATION = range(3)

RAISED, NOT_FINITE = 1, 2
"""Faults of a law."""


@inlined
def vector(address: int, count: int) -> FloatArray:
    """Return the array of shape (count,) at an address."""
    return numba.carray(pointer(address), count, np.float64)  # type: ignore[no-any-return]


@inlined
def matrix(address: int, rows: int, columns: int) -> FloatArray:
    """Return the array of shape (rows, columns) at an address."""
    return numba.carray(pointer(address), (rows, columns), np.float64)  # type: ignore[no-any-return]


@inlined
def numbers(address: int, count: int) -> IntArray:
    """Return the array of whole numbers of shape (count,) at an address."""
    return numba.carray(pointer(address), count, np.int64)  # type: ignore[no-any-return]
