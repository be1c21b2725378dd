# SPDX-License-Identifier: Apache-2.0
"""One part of a flock in space, in the view of a camera of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection, TriMesh
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.tri import Triangulation

from flock_sim.physics.arrays import FloatArray, IntArray
from flock_tools.figures.style import INK
from flock_tools.scene.camera import Camera
from flock_tools.scene.landmarks import Landmarks
from flock_tools.scene.lettering import ABOVE, label_rank, label_text
from flock_tools.scene.marker import Kind, Shape
from flock_tools.scene.shapes import Scene
from flock_tools.scene.snapshot import Snapshot

SMALL = 7.5
"""Size of labels, in pt."""

RAISED = 20.0
"""Height of a span ratio above the place of the label below it, in pt."""


@dataclass(frozen=True)
class Panel:
    """The shapes of some birds of a scene."""

    birds: IntArray
    """The indices of the birds."""
    snapshot: Snapshot
    upwash: tuple[int, ...]
    """Rows and columns of the plane behind the birds."""
    shapes: dict[str, list[Shape]]
    landmarks: Landmarks
    camera: Camera

    @classmethod
    def of(cls, shown: Scene, birds: IntArray, with_plane: bool) -> Self:
        """Return the panel of `birds`, and of the plane behind the flock if `with_plane`."""
        numbers = set(birds + 1)
        shapes = {
            name: [s for s in shown.shapes if s.group == name and s.number in numbers]
            for name in ("wakes", "trails", "birds")
        }
        shapes["upwash"] = [s for s in shown.shapes if s.group == "upwash" and with_plane]
        places = np.array([shape.origin for shape in shapes["birds"]])
        landmarks = Landmarks.ahead_of(places, shown.snapshot.metre)
        framed = [shape for name in shapes for shape in shapes[name] if name != "trails"]
        camera = Camera.at(framed, landmarks.points)
        return cls(birds, shown.snapshot, shown.upwash.shape, shapes, landmarks, camera)

    def draw(self, axes: Axes) -> list[Text]:
        """Draw the birds; return the labels that may overlap, the most important first."""
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, self.camera.height))
        axes.set_axis_off()
        planes = self.shapes["upwash"]
        for plane in planes:
            self._draw_plane(axes, plane)
        self._draw_wakes(axes)
        behind = max((float(plane.points[0, 0]) for plane in planes), default=-np.inf)
        for trail in self.shapes["trails"]:
            self._draw_trail(axes, trail, behind)
        _draw_faces(axes, self.camera, self.shapes["birds"])
        return [*self._draw_landmarks(axes), *self._draw_labels(axes)]

    def _draw_plane(self, axes: Axes, plane: Shape) -> None:
        """Draw the field behind the birds, with colours interpolated between its cells."""
        rows, columns = self.upwash
        corner = np.arange(rows * columns).reshape(rows, columns)
        _draw_smooth(axes, self.camera, plane.points, plane.colours, _triangles(corner))

    def _draw_wakes(self, axes: Axes) -> None:
        """Draw all wakes, the nearest on top, with colours interpolated between their corners."""
        wakes = self.shapes["wakes"]
        if not wakes:
            return
        points = np.concatenate([shape.points + shape.origin for shape in wakes])
        colours = np.concatenate([shape.colours for shape in wakes])
        corners = np.arange(len(points)).reshape(-1, 3)
        _draw_smooth(axes, self.camera, points, colours, corners)

    def _draw_trail(self, axes: Axes, trail: Shape, behind: float) -> None:
        """Draw the part of a trail that is in front of the plane at `behind`, in m."""
        ends = np.stack([trail.points[:-1], trail.points[1:]], axis=1)
        front = (ends[..., 0] > behind).all(axis=1)
        seen, distance = self.camera.see(ends[front])
        before = (distance > 0.0).all(axis=1)
        axes.add_collection(
            LineCollection(
                list(seen[before]), colors=trail.colours[1:][front][before], linewidths=0.9
            )
        )

    def _draw_landmarks(self, axes: Axes) -> list[Text]:
        """Draw the bar and the arrow along the flight."""
        marks = self.landmarks
        lines = [self.camera.see(points)[0] for points in (marks.bar, marks.arrow, marks.head)]
        axes.add_collection(LineCollection(lines, colors=INK, linewidths=1.0))
        beside, ahead = lines[0][lines[0][:, 0].argmax()], lines[1].mean(axis=0)
        return [
            _label(axes, beside, f"  {marks.length:g} m", ha="left", va="center"),
            _label(axes, ahead, "  flight", ha="left", va="center"),
        ]

    def _draw_labels(self, axes: Axes) -> list[Text]:
        """Write number and drag saved of each bird, and span ratios that are not 1.

        Return the labels, the most important first: those of the leader and of both ends, of birds
        of another span, of every tenth bird, and of all others.
        """
        labels = []
        for shape in self.shapes["birds"]:
            ratio = self.snapshot.span_ratio[shape.number - 1]
            above = np.array(shape.origin) + (0.0, 0.0, ABOVE * self.snapshot.metre)
            (place,), _ = self.camera.see(above[np.newaxis])
            text = label_text(self.snapshot, shape.number)
            label = _label(axes, place, text, ha="center", va="bottom")
            rank = label_rank(self.snapshot, shape.number)
            labels.append((rank, place[1], label))
            if ratio != 1.0:
                told = f"$\\lambda$ = {ratio:g}"
                span = _label(axes, place, told, ha="center", va="bottom", above=RAISED)
                labels.append((rank, place[1], span))
        labels.sort(key=lambda label: label[:2])  # of equal rank, the nearest is the lowest
        return [label for _, _, label in labels]


def _label(axes: Axes, place: FloatArray, text: str, ha: str, va: str, above: float = 0.0) -> Text:
    """Write `text` at a place on the picture, or `above` it by this number of pt."""
    return axes.annotate(
        text,
        (float(place[0]), float(place[1])),
        xytext=(0.0, above),
        textcoords="offset points",
        ha=ha,
        va=va,
        fontsize=SMALL,
        path_effects=[withStroke(linewidth=2.0, foreground="white")],
    )


def _triangles(corner: IntArray) -> IntArray:
    """Return the corners of the triangles of a grid, shape (triangles, 3)."""
    first, second, third, fourth = (
        part.ravel()
        for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:])
    )
    halves = np.stack([first, second, third]), np.stack([first, third, fourth])
    return np.concatenate(halves, axis=1).T


def _draw_smooth(
    axes: Axes, camera: Camera, points: FloatArray, colours: FloatArray, corners: IntArray
) -> None:
    """Draw opaque triangles whose colours change steadily from corner to corner.

    Mixed with the white of the page, the colours would no longer tell up from down in grey.
    """
    seen, distance = camera.see(points)
    nearest_last = np.argsort(-distance[corners].mean(axis=1), kind="stable")
    mesh = TriMesh(Triangulation(seen[:, 0], seen[:, 1], corners[nearest_last]))
    opaque = colours.copy()
    opaque[:, 3] = 1.0
    mesh.set_facecolor([tuple(colour) for colour in opaque])
    mesh.set_rasterized(True)
    axes.add_collection(mesh, autolim=False)


def _draw_faces(axes: Axes, camera: Camera, shapes: Sequence[Shape]) -> None:
    """Draw the faces of `shapes`, the nearest on top, on a white background."""
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
