# SPDX-License-Identifier: Apache-2.0
"""A scene as the messages that RViz and Foxglove draw, serialised as CDR.

rclpy converts a message number by number, which is too slow for a scene of about ten thousand
points. A test compares these bytes with the generated message types.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from flock_sim.messages.cdr import ENCAPSULATION, align, put
from flock_sim.messages.state import FRAME as WORLD
from flock_sim.messages.topics import bird_name
from flock_sim.physics.arrays import FloatArray
from flock_tools.scene.marker import Kind, Shape
from flock_tools.scene.shapes import Scene
from flock_tools.scene.snapshot import Snapshot

FRAME = "flock"
"""The frame that moves with the leader: x forward, y to the left, z up, in m. Its origin in WORLD,
in which the air is at rest, is the leader's position."""

MARKERS = "visualization_msgs/msg/MarkerArray"
IMAGE = "sensor_msgs/msg/Image"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
ODOMETRY = "nav_msgs/msg/Odometry"

ADD, DELETE_ALL = 0, 3

COVARIANCE = bytes(36 * 8)
"""A covariance of 6 x 6 zeros."""

NUMBERS, COLORS = "32FC1", "rgb8"
"""Encodings of images: one float32 per pixel, in m/s, or three bytes."""


def markers(scene: Scene, anew: bool) -> bytes:
    """Return a MarkerArray. With `anew`, it first removes all earlier markers."""
    data = bytearray(ENCAPSULATION)
    put(data, "I", len(scene.shapes) + anew)
    if anew:
        _put_marker(data, scene.snapshot.stamp, Shape("", 0, Kind.LINE), DELETE_ALL)
    for shape in scene.shapes:
        _put_marker(data, scene.snapshot.stamp, shape, ADD)
    return bytes(data)


def image(snapshot: Snapshot, pixels: npt.NDArray[Any], encoding: str) -> bytes:
    """Return an Image of `pixels`, whose first two dimensions are rows and columns."""
    rows, columns = pixels.shape[:2]
    data = bytearray(ENCAPSULATION)
    _put_header(data, snapshot.stamp, FRAME)
    _put_all(data, "II", (rows, columns))
    put(data, "text", encoding)
    _put_all(data, "BI", (0, pixels.nbytes // rows))
    put(data, "I", pixels.nbytes)
    data += pixels.astype(pixels.dtype.newbyteorder("<")).tobytes()
    return bytes(data)


def transform(snapshot: Snapshot) -> bytes:
    """Return a TransformStamped from FRAME, which moves with the flock, to WORLD."""
    data = bytearray(ENCAPSULATION)
    _put_flock(data, snapshot)
    return bytes(data)


def transforms(snapshot: Snapshot, birds: Sequence[int] = ()) -> bytes:
    """Return the same as a TFMessage, the type of /tf, with the frames of `birds`, from 1, too."""
    data = bytearray(ENCAPSULATION)
    put(data, "I", 1 + len(birds))
    _put_flock(data, snapshot)
    for bird in birds:
        _put_pose(data, snapshot, bird_name(bird), snapshot.world[bird - 1])
    return bytes(data)


def odometry(snapshot: Snapshot, bird: int) -> bytes:
    """Return the Odometry of `bird`, from 1. All covariances are 0, since its state is exact."""
    data = bytearray(ENCAPSULATION)
    _put_pose(data, snapshot, bird_name(bird), snapshot.world[bird - 1])
    data += COVARIANCE
    speed = float(snapshot.world_speed[bird - 1])
    _put_all(data, 6 * "d", (speed, 0.0, 0.0, 0.0, 0.0, 0.0))
    data += COVARIANCE
    return bytes(data)


def _put_flock(data: bytearray, snapshot: Snapshot) -> None:
    _put_pose(data, snapshot, FRAME, (snapshot.origin * snapshot.metre, 0.0, 0.0))


def _put_pose(data: bytearray, snapshot: Snapshot, frame: str, place: Iterable[float]) -> None:
    """Append the header, the name of `frame`, and its origin and orientation in WORLD."""
    _put_header(data, snapshot.stamp, WORLD)
    put(data, "text", frame)
    _put_all(data, 7 * "d", (*place, 0.0, 0.0, 0.0, 1.0))


def _put_header(data: bytearray, stamp: tuple[int, int], frame: str) -> None:
    _put_all(data, "iI", stamp)
    put(data, "text", frame)


def _put_marker(data: bytearray, stamp: tuple[int, int], shape: Shape, action: int) -> None:
    """Append a visualization_msgs/Marker, field by field."""
    _put_header(data, stamp, FRAME)
    put(data, "text", shape.group)
    _put_all(data, 3 * "i", (shape.number, shape.kind, action))
    _put_all(data, 10 * "d", (*shape.origin, 0.0, 0.0, 0.0, 1.0, *shape.scale))
    # The colour of points without a colour of their own.
    _put_all(data, 4 * "f", shape.colours[0])
    _put_all(data, "iI?", (0, 0, False))  # lifetime, frame_locked
    _put_points(data, shape.points, "<f8")
    _put_points(data, shape.colours if len(shape.points) else shape.points, "<f4")
    put(data, "text", "")  # texture_resource, and the texture itself
    _put_header(data, (0, 0), "")
    put(data, "text", "")
    _put_all(data, 2 * "I", (0, 0))  # its data, uv_coordinates
    put(data, "text", shape.text)
    put(data, "text", "")  # mesh_resource, and the mesh itself
    put(data, "text", "")
    _put_all(data, "I?", (0, False))


def _put_points(data: bytearray, points: FloatArray, kind: str) -> None:
    put(data, "I", len(points))
    if len(points):
        align(data, np.dtype(kind).itemsize)
        data += np.ascontiguousarray(points, dtype=kind).tobytes()


def _put_all(data: bytearray, kinds: str, values: Iterable[float]) -> None:
    """Append numbers, each of its kind."""
    for kind, value in zip(kinds, values, strict=True):
        put(data, kind, value)
