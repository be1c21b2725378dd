# SPDX-License-Identifier: Apache-2.0
"""Counter-based random numbers: each is a function of its seed, link, step and purpose only.

The generator is Philox 4x32-10 of Salmon, Moraes, Dror and Shaw, *Parallel random numbers: as easy
as 1, 2, 3* (SC 2011): a keyed permutation of 128-bit counters. The key is the seed; the counter
gives the link, the step and the purpose. So a number is the same in every process, in any order,
and again after a rewind. Members with equal seeds get the same numbers.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from flock_sim.physics import logarithm, trigonometry
from flock_sim.physics.compile import kernel

Word: TypeAlias = np.uint64

FATE = 0
"""Purpose of numbers that decide whether a message is lost, and how late it is."""
NOISE = 1
"""Purpose of the noise on the message sent at stage 0; that of stage s is NOISE + s."""

ROUNDS = 10
_LOW = np.uint64(0xFFFFFFFF)
_WORD = np.uint64(32)
_MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)  # golden ratio, square root of 3

_HIGH_BITS, _LOW_BITS = np.uint64(5), np.uint64(6)  # 27 and 26 bits are left of 32: 53 in all
_SHIFT, _UNIT = float(1 << 26), 1.0 / (1 << 53)

_log_of_quotient = kernel(logarithm.log_of_quotient)
_sine_and_cosine = kernel(trigonometry.sine_and_cosine)


@kernel
def philox(
    key: int | Word, c0: int | Word, c1: int | Word, c2: int | Word, c3: int | Word
) -> tuple[Word, Word, Word, Word]:
    """Return four words of 32 bits for a key of 64 bits and a counter of four words of 32."""
    k0 = np.uint64(key) & _LOW
    k1 = np.uint64(key) >> _WORD
    w0, w1, w2, w3 = np.uint64(c0), np.uint64(c1), np.uint64(c2), np.uint64(c3)
    for _ in range(ROUNDS):
        first = _MULTIPLIERS[0] * w0
        second = _MULTIPLIERS[1] * w2
        w0, w1, w2, w3 = (
            (second >> _WORD) ^ w1 ^ k0,
            second & _LOW,
            (first >> _WORD) ^ w3 ^ k1,
            first & _LOW,
        )
        k0 = (k0 + _WEYL[0]) & _LOW
        k1 = (k1 + _WEYL[1]) & _LOW
    return w0, w1, w2, w3


@kernel
def uniforms(seed: int, source: int, target: int, step: int, kind: int) -> tuple[float, float]:
    """Return two independent uniform numbers of [0, 1) for a message of a link.

    `seed` and `step` are below 2**63, the birds `source` and `target` below 2**16.
    """
    moment = np.uint64(step)
    link = (np.uint64(source) << np.uint64(16)) | np.uint64(target)
    a, b, c, d = philox(seed, moment & _LOW, moment >> _WORD, link, kind)
    return (
        (float(a >> _HIGH_BITS) * _SHIFT + float(b >> _LOW_BITS)) * _UNIT,
        (float(c >> _HIGH_BITS) * _SHIFT + float(d >> _LOW_BITS)) * _UNIT,
    )


@kernel
def gaussians(seed: int, source: int, target: int, step: int, kind: int) -> tuple[float, float]:
    """Return two numbers of the standard normal distribution, by Box and Muller's method."""
    u, v = uniforms(seed, source, target, step, kind)
    radius = math.sqrt(-2.0 * _log_of_quotient(1.0 - u, 1.0, -u))
    sine, cosine = _sine_and_cosine(v)
    return radius * cosine, radius * sine
