# SPDX-License-Identifier: Apache-2.0
"""The equation of motion of one bird, as functions of numbers that all kernels share.

The distributed flight and the reference compute the same functions in the same order. Therefore
their results agree bit for bit.
"""

from math import nan

from flock_sim.physics.aerodynamics import ahead_integral, split_drag
from flock_sim.physics.compile import inlined
from flock_sim.physics.interaction import PER_FOUR_PI


@inlined
def canonical(value: float) -> float:
    """Return `value`, and for every NaN the one with the same bits on all machines.

    The sign of the NaN of inf - inf depends on the processor.
    """
    return value if value == value else nan


@inlined
def circulation_at(speed: float, coefficient: float) -> float:
    """Return Gamma_j = lambda_j^2 Gamma_min / U_j, in b U_min. Eq. (Gamma), scaled."""
    return canonical(coefficient / speed)


@inlined
def acceleration(
    speed: float, drag: float, mass: float, thrust: float, profile: float, induced: float
) -> float:
    """Return dU_j/dt = (T_j - D_j - sum_i D_ij) / m_j, in U_min^2 / b. Eq. (eom3).

    `drag` is the interaction drag sum_i D_ij; D_j = profile U^2 + induced U^-2.
    """
    square = speed * speed
    return (thrust - (profile * square + induced / square) - drag) / mass


@inlined
def drag_of_pair(
    x: float,
    lateral: float,
    half: float,
    other_half: float,
    even: float,
    circulation: float,
    other_circulation: float,
) -> tuple[float, float]:
    """Return the interaction drags (on the bird, on the other), in rho b^2 U_min^2. Eq. (Djk2).

    `x` is the other's position minus the bird's, `lateral` their lateral distance,
    `half` and `other_half` their vortex half-spans, all in b; `even` is E of the pair.
    """
    strength = circulation * other_circulation * PER_FOUR_PI
    ahead = ahead_integral(abs(x), lateral, half, other_half)
    return split_drag(x, strength, ahead, even)
