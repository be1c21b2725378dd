# SPDX-License-Identifier: Apache-2.0
"""The model of the paper as a plain JAX script in double precision, for ensembles.py.

It uses nothing of Flock. Of several ways to write it, this is the fastest that was found for 1,024
members: arrays (pairs, members), products with incidence matrices instead of gathers and scatters,
and loops over steps and stages that XLA compiles. (XLA fuses unrolled stages and slices, and then
computes their common parts many times.) A process of this script serves rates: see served.py.
"""

from __future__ import annotations

import os
from functools import partial
from math import pi, sqrt
from typing import NamedTuple

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"  # one thread per call

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platforms", "cpu")
jax.config.update("jax_cpu_enable_async_dispatch", False)  # a call returns with its result

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jax import Array, lax  # noqa: E402
from served import rate, serve, span_ratios  # noqa: E402

# The standard bird in SI units, and its dimensionless constants.
MASS, WING_SPAN, AIR_DENSITY, MIN_DRAG_SPEED, CRUISE_SPEED = 3.8, 1.5, 1.225, 18.0, 18.5
OSWALD_EFFICIENCY, ZERO_LIFT_DRAG, ASPECT_RATIO = 0.8, 0.025, 9.0
U_0 = CRUISE_SPEED / MIN_DRAG_SPEED
M_0 = MASS / (AIR_DENSITY * (WING_SPAN / 2) ** 3)
K = 2 * ZERO_LIFT_DRAG / ASPECT_RATIO
T_0 = K * (U_0**2 + U_0**-2)
GAMMA_MIN = 4 * sqrt(OSWALD_EFFICIENCY * ZERO_LIFT_DRAG / (pi * ASPECT_RATIO))
TIP_SPACING = pi / 4 - 1

DT = 1.0
NODE = np.array([0.5, 0.5, 1.0, 0.0])
WEIGHT = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
"""The Runge-Kutta method: the factor of a stage's slope in the next stage, and in the step."""


class Flocks(NamedTuple):
    """The constants of an ensemble. Each bird's are (birds, members), each pair's (pairs, ...)."""

    mass: Array
    thrust: Array
    profile: Array
    induced: Array
    circulation: Array
    tail: Array  # (pairs, birds): 1 where the bird is the first of the pair, otherwise 0
    head: Array  # the same with the second bird
    edges: tuple[Array, Array, Array, Array]  # lateral distances p, q, r, s of the vortices
    even: Array  # E of each pair


def flocks(ratio: np.ndarray, coupling: str) -> Flocks:
    """Return the flocks with the span ratios `ratio` (birds, members)."""
    birds = len(ratio)
    reach = birds - 1 if coupling == "all" else 1
    pairs = [(i, j) for i in range(birds) for j in range(i + 1, min(birds, i + reach + 1))]
    tail, head = np.transpose(pairs)
    half = pi / 4 * ratio
    between = ratio[:-1] + ratio[1:] + TIP_SPACING
    place = np.concatenate([np.zeros_like(ratio[:1]), np.cumsum(between, axis=0)])
    lateral, both = place[head] - place[tail], half[tail] + half[head]
    apart = np.abs(half[tail] - half[head])
    p, q, r, s = lateral + both, lateral + apart, lateral - apart, lateral - both
    constants = Flocks(
        mass=ratio**3 * M_0,
        thrust=ratio**4 * T_0,
        profile=ratio**2 * K,
        induced=ratio**4 * K,
        circulation=ratio**2 * GAMMA_MIN,
        tail=np.eye(birds)[tail],
        head=np.eye(birds)[head],
        edges=(p, q, r, s),
        even=np.log1p(-4 * half[tail] * half[head] / (lateral**2 - apart**2)),
    )
    return jax.tree.map(jnp.asarray, constants)


def acceleration(of: Flocks, position: Array, speed: Array) -> Array:
    """Return dU/dt of all birds, (birds, members)."""
    circulation = of.circulation / speed
    x = (of.head - of.tail) @ position
    strength = (of.tail @ circulation) * (of.head @ circulation) / (4 * pi)
    p, q, r, s = of.edges
    distance = jnp.abs(x)
    square = distance * distance
    jp, jq, jr, js = (jnp.sqrt(square + edge * edge) for edge in of.edges)
    outer = (jp + p + js + s) / ((jp + p) * (js + s))
    inner = (jq + q + jr + r) / ((jq + q) * (jr + r))
    quotient = (distance + jp) * (distance + js) / ((distance + jq) * (distance + jr))
    ahead = jnp.log(quotient) - distance * (outer - inner)
    behind = 2.0 * of.even - ahead
    on_tail = strength * jnp.where(x > 0.0, behind, ahead)
    on_head = strength * jnp.where(x < 0.0, behind, ahead)
    drag = of.tail.T @ on_tail + of.head.T @ on_head
    square = speed * speed
    return (of.thrust - of.profile * square - of.induced / square - drag) / of.mass


@jax.jit
def advance(of: Flocks, position: Array, speed: Array, steps: int) -> tuple[Array, Array]:
    """Take `steps` steps; return position and speed, (birds, members)."""
    node, weight = jnp.asarray(DT * NODE), jnp.asarray(DT * WEIGHT)

    def step(_: int, begun: tuple[Array, Array]) -> tuple[Array, Array]:
        x_0, u_0 = begun

        def stage(k: int, now: tuple[Array, ...]) -> tuple[Array, ...]:
            x, u, x_sum, u_sum = now
            slope = acceleration(of, x, u)
            x_sum, u_sum = x_sum + weight[k] * u, u_sum + weight[k] * slope
            return x_0 + node[k] * u, u_0 + node[k] * slope, x_sum, u_sum

        _, _, x, u = lax.fori_loop(0, len(NODE), stage, (x_0, u_0, x_0, u_0))
        return x, u

    return lax.fori_loop(0, steps, step, (position, speed))


class Ensemble:
    """Flocks in flight, from the V of the homogeneous flock at U_0."""

    def __init__(self, coupling: str, ratio: np.ndarray) -> None:
        birds, members = ratio.shape
        places = np.abs(np.arange(birds) - birds // 2)
        start = np.repeat(-(2 + TIP_SPACING) * places[:, np.newaxis], members, axis=1)
        self._flocks = flocks(ratio, coupling)
        self.position, self.speed = jnp.asarray(start), jnp.asarray(np.full(ratio.shape, U_0))

    def advance(self, steps: int) -> None:
        """Take `steps` steps, to their end."""
        flown = advance(self._flocks, self.position, self.speed, steps)
        self.position, self.speed = jax.block_until_ready(flown)


def states(birds: int, members: int, coupling: str, steps: int) -> list[list[list[float]]]:
    """Return position and speed after `steps` steps, each (birds, members)."""
    flown = Ensemble(coupling, span_ratios(birds, members))
    flown.advance(steps)
    return [np.asarray(flown.position).tolist(), np.asarray(flown.speed).tolist()]


def ensemble(birds: int, members: int, coupling: str) -> float:
    """Return member-steps per second."""
    return rate(partial(Ensemble, coupling), span_ratios(birds, members))


if __name__ == "__main__":
    serve(states, ensemble)
