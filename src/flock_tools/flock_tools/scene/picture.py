# SPDX-License-Identifier: Apache-2.0
"""The scene that `view` publishes, as a picture file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from flock_sim.messages.types import BILLION
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.recording.run import Run
from flock_tools.figures.style import DRAG_SAVED, STYLE, flock_name, saved_scale
from flock_tools.runs.dataset import read
from flock_tools.scene.shapes import UPWASH, Kind, Scene, Shape, scene
from flock_tools.scene.snapshot import Snapshot

WIDTH = 10.0
"""Width of the picture, in inches."""

BARS = 0.75
"""Height of the room for colour bars, in inches."""

ELEVATION, AZIMUTH = 30.0, 15.0
"""Direction of view, in degrees: from in front of the flock, above and a little to its left."""

DISTANCE = 1.6
"""Distance of the camera from the middle of the scene, over the scene's diagonal."""

MARGIN = 0.03
"""Margin beside the scene, over its width."""

MOST_TRAIL = 300
"""Largest number of points of a trail, approximately."""


def scene_of(run: Run, time: float | None, m: int) -> Scene:
    """Return the scene of the member with index `m` at `time` in b / U_min; None: the last time.

    Raises FlockError if nothing was recorded at that time.
    """
    configuration, state = run.configuration, run.at(time)
    stamp = divmod(configuration.stamp(state.step), BILLION)
    snapshot = Snapshot.of(configuration, state, configuration.span_ratio, m, stamp)
    rows = state.step // configuration.record_every + 1
    history = read(run, end=state.time, stride=-(-rows // MOST_TRAIL)).position[..., m]
    leader = history.sel(bird=formation.leader(configuration.birds))
    return scene(snapshot, list((history - leader).transpose("time", "bird").to_numpy()))


def draw_scene(shown: Scene) -> Figure:
    """Return the picture of a scene. Without a bird, it says so."""
    if not shown.snapshot.known.any():
        return _empty(shown)
    groups = {
        name: [shape for shape in shown.shapes if shape.group == name]
        for name in ("upwash", "wakes", "trails", "birds", "labels")
    }
    camera = Camera.at([shape for name in groups for shape in groups[name] if name != "trails"])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, WIDTH * camera.height + BARS))
        share = BARS / figure.get_figheight()
        axes = figure.add_axes((0.0, share, 1.0, 1.0 - share))
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, camera.height))
        axes.set_axis_off()
        for name in ("upwash", "wakes"):
            _draw_faces(axes, camera, groups[name])
        for shape in groups["trails"]:
            _draw_trail(axes, camera, shape, groups["upwash"])
        _draw_faces(axes, camera, groups["birds"])
        for shape in groups["labels"]:
            (place,), _ = camera.see(np.array([shape.origin]))
            label = axes.text(
                place[0], place[1], shape.text, ha="center", va="bottom", fontsize=7.0
            )
            label.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
        axes.text(
            0.02, 0.98, _title(shown.snapshot), transform=axes.transAxes, va="top", fontsize=10
        )
        saved = ScalarMappable(saved_scale(shown.snapshot.saved), DRAG_SAVED)
        _bar(figure, 0.07, saved, "drag reduction $\\eta_i$ (%)")
        air = ScalarMappable(Normalize(-shown.most_upwash, shown.most_upwash), UPWASH)
        _bar(figure, 0.57, air, "upward air speed (m/s)")
    return figure


def _empty(shown: Scene) -> Figure:
    """Return the picture of a flock of which no bird can be drawn."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.0))
        figure.text(0.02, 0.92, _title(shown.snapshot), va="top", fontsize=10)
        figure.text(0.5, 0.4, "no bird has a finite position and circulation", ha="center")
    return figure


@dataclass(frozen=True)
class Camera:
    """The position and direction of the camera, and the part of its view in the picture."""

    place: FloatArray
    axes: FloatArray
    """Unit vectors to the right, up, and into the scene, shape (3, 3)."""
    low: FloatArray
    width: float
    height: float
    """Height of the picture, over its width."""

    @classmethod
    def at(cls, shapes: Sequence[Shape]) -> Self:
        """Return the camera that sees all of `shapes`."""
        points = np.concatenate([*(shape.points + shape.origin for shape in shapes)])
        low, high = points.min(axis=0), points.max(axis=0)
        azimuth, elevation = np.radians(AZIMUTH), np.radians(ELEVATION)
        into = -np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        axes = np.stack([right, np.cross(right, into), into])
        place = 0.5 * (low + high) - DISTANCE * float(np.linalg.norm(high - low)) * into
        unframed = cls(place, axes, np.zeros(2), 1.0, 1.0)
        seen, _ = unframed.see(points)
        least, extent = seen.min(axis=0), np.ptp(seen, axis=0)
        margin = MARGIN * extent[0]
        width = extent[0] + 2.0 * margin
        height = (extent[1] + 3.0 * margin) / width
        return cls(place, axes, least - margin, width, height)

    def see(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the places of points (..., 3) on the picture, (..., 2), and their distances."""
        seen = (points - self.place) @ self.axes.T
        return (seen[..., :2] / seen[..., 2:] - self.low) / self.width, seen[..., 2]


def _draw_faces(axes: Axes, camera: Camera, shapes: Sequence[Shape]) -> None:
    """Draw the faces of `shapes`, the nearest on top, on a white background."""
    if not shapes:
        return
    corners = [polygon for shape in shapes for polygon in polygons(shape)]
    colours = np.concatenate([_face_colours(shape) for shape in shapes])
    opaque = 1.0 - colours[:, 3:] * (1.0 - colours[:, :3])
    seen = [camera.see(polygon) for polygon in corners]
    order = np.argsort([-float(depth.mean()) for _, depth in seen])
    axes.add_collection(
        PolyCollection(
            [seen[k][0] for k in order],
            facecolors=opaque[order],
            edgecolors=opaque[order],
            linewidths=0.25,
        )
    )


def _draw_trail(axes: Axes, camera: Camera, trail: Shape, plane: Sequence[Shape]) -> None:
    """Draw the part of a trail that is in front of the plane."""
    ends = np.stack([trail.points[:-1], trail.points[1:]], axis=1)
    behind = max((float(shape.points[0, 0]) for shape in plane), default=-np.inf)
    front = (ends[..., 0] > behind).all(axis=1)
    seen, _ = camera.see(ends[front])
    axes.add_collection(LineCollection(list(seen), colors=trail.colours[1:][front], linewidths=0.9))


def polygons(shape: Shape) -> FloatArray:
    """Return the corners of each face of a shape. A thin cube is a face of four corners."""
    if shape.kind == Kind.TRIANGLES:
        return np.asarray(shape.points.reshape(-1, 3, 3) + shape.origin)
    thin = int(np.argmin(shape.scale))
    across, along = (axis for axis in range(3) if axis != thin)
    corners = np.zeros((4, 3))
    corners[:, across] = 0.5 * shape.scale[across] * np.array([-1.0, 1.0, 1.0, -1.0])
    corners[:, along] = 0.5 * shape.scale[along] * np.array([-1.0, -1.0, 1.0, 1.0])
    return np.asarray(shape.points[:, np.newaxis] + corners + shape.origin)


def _face_colours(shape: Shape) -> FloatArray:
    """Return one colour per face: the mean of its corners' colours."""
    if shape.kind == Kind.TRIANGLES:
        return np.asarray(shape.colours.reshape(-1, 3, 4).mean(axis=1))
    return shape.colours


def _title(snapshot: Snapshot) -> str:
    name = flock_name(snapshot.configuration, snapshot.member)
    saved = np.mean(snapshot.saved)
    return f"{name}\nt = {snapshot.state.time:g}:  mean drag reduction {saved:.1f} %"


def _bar(figure: Figure, left: float, colours: ScalarMappable, name: str) -> None:
    """Draw a colour bar along the bottom."""
    height = figure.get_figheight()
    axes = figure.add_axes((left, 0.42 / height, 0.36, 0.12 / height))
    bar = figure.colorbar(colours, cax=axes, orientation="horizontal")
    bar.set_label(name)
    bar.outline.set_visible(False)
