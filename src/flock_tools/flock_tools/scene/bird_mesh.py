# SPDX-License-Identifier: Apache-2.0
"""The shape of a bird in space, made of triangles.

Forward is x, left is y and up is z; the unit is the bird's semi-span, so that the wing tips are at
y = 1 and -1.
"""

from __future__ import annotations

import numpy as np

from flock_sim.physics.arrays import FloatArray
from flock_tools.figures.bird_outline import RIGHT_HALF

_WING = [(0, 1, 8), (0, 8, 9), (1, 7, 8), (1, 2, 7), (2, 6, 7), (2, 3, 6), (3, 5, 6), (3, 4, 5)]
"""Triangles between the points of the right half of the outline."""

_BODY = [(-0.3, 0.0), (-0.12, 0.055), (0.12, 0.06), (0.26, 0.022), (0.42, 0.03), (0.5, 0.0)]
"""From tail to beak: distance in front of the wing's centre, and radius."""

_AROUND = 6
"""Number of sides of the body."""

_LIGHT = np.array([0.25, 0.3, 0.92])
"""Direction to the light, of length 1 approximately."""


def _wings() -> FloatArray:
    """Return the triangles of both wings, which are bent as a goose's are; (triangles, 3, 3)."""
    across, along = RIGHT_HALF.T
    height = 0.17 * across - 0.1 * across**2
    right = np.column_stack([along, -across, height])
    left = right * (1.0, -1.0, 1.0)
    corners = np.array(_WING)
    return np.concatenate([right[corners], left[corners[:, ::-1]]])


def _body() -> FloatArray:
    """Return the triangles of a body with a neck; (triangles, 3, 3)."""
    angle = 2.0 * np.pi / _AROUND * np.arange(_AROUND + 1)
    rings = np.array(
        [
            [(along, radius * np.cos(a), radius * np.sin(a) + 0.01) for a in angle]
            for along, radius in _BODY
        ]
    )
    first, second = rings[:-1, :-1], rings[1:, :-1]
    third, fourth = rings[1:, 1:], rings[:-1, 1:]
    halves = [np.stack([first, second, third], 2), np.stack([first, third, fourth], 2)]
    triangles: FloatArray = np.concatenate([half.reshape(-1, 3, 3) for half in halves])
    return triangles[_doubled_area(triangles) > 0.0]


def _doubled_area(triangles: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(_normals(triangles), axis=1))


def _normals(triangles: FloatArray) -> FloatArray:
    edges = triangles[:, 1:] - triangles[:, :1]
    return np.cross(edges[:, 0], edges[:, 1])


BIRD = np.concatenate([_wings(), _body()])
"""The triangles of a bird, shape (triangles, 3 corners, 3)."""

SHADE = 0.68 + 0.32 * np.abs(_normals(BIRD) @ _LIGHT) / _doubled_area(BIRD)
"""Brightness of each triangle, shape (triangles,): viewers do not light coloured triangles."""
