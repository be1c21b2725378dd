# SPDX-License-Identifier: Apache-2.0
"""Texts of a scene can be read: on every background, and none on top of another one."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.textpath import TextPath

from flock_tools.scene.lettering import label_text, labels, legends
from flock_tools.scene.marker import INK, Kind, Shape
from flock_tools.scene.snapshot import Snapshot
from unit.scene.test_shapes import RATIO, snapshot

BACKGROUNDS = {
    "white": "#ffffff",
    "the layouts": "#ebeef1",
    "Foxglove and Lichtblick, light": "#ececec",
    "Rviz": "#303030",
    "Foxglove and Lichtblick, dark": "#15151a",
    "Rerun, dark": "#0d1011",
    "black": "#000000",
}


def luminance(colour: str | tuple[float, ...]) -> float:
    """The relative luminance of WCAG 2."""
    value = np.array(to_rgb(colour))
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def contrast(one: str | tuple[float, ...], other: str | tuple[float, ...]) -> float:
    darker, lighter = sorted((luminance(one), luminance(other)))
    return (lighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize("name", BACKGROUNDS)
def test_the_contrast_of_texts_and_trails_is_enough_on_every_background(name: str) -> None:
    assert contrast(INK, BACKGROUNDS[name]) >= 3.0


def test_the_contrast_is_enough_on_the_plates_of_foxglove() -> None:
    luma = np.dot(INK[:3], (0.2126, 0.7152, 0.0722))
    assert luma < 0.45  # Foxglove and Lichtblick make the plate of such a text white
    assert contrast(INK, "white") >= 4.0


def box(shape: Shape, up: np.ndarray) -> np.ndarray:
    """The lower left and the upper right corner of a text, seen from far behind."""
    right = np.array([0.0, -1.0, 0.0])
    height, lines = shape.scale[2], shape.text.split("\n")
    width = max(TextPath((0, 0), line, size=height).get_extents().x1 for line in lines)
    half = 0.5 * np.array([width, 1.15 * height * len(lines)])
    middle = np.array([right @ shape.origin, up @ shape.origin])
    return np.array([middle - half, middle + half])


def wedge(birds: int) -> Snapshot:
    """A flock in a V, with the angle of the usual start."""
    position = 1000.0 - 1.785 * np.abs(np.arange(birds) - birds // 2)
    return snapshot(np.ones(birds), position=position)


@pytest.mark.parametrize("elevation", [-25.0, -40.0, 90.0, 60.0, 38.0, 25.0])
@pytest.mark.parametrize("birds", [1, 2, 3, 13, 101, 301])
def test_no_text_is_on_top_of_another_one(birds: int, elevation: float) -> None:
    """Seen from above the horizon, from behind; negative elevations are seen from in front."""
    e = np.radians(elevation)
    up = np.array([np.sin(e), 0.0, np.cos(e)])
    shown = wedge(birds)
    shapes = [*labels(shown), *legends(shown, 12.3)]
    boxes = [(shape.text, box(shape, up)) for shape in shapes if shape.kind == Kind.TEXT]
    assert len(boxes) >= 5 + min(birds, 10)
    for (one, first), (other, second) in combinations(boxes, 2):
        common = np.minimum(first[1], second[1]) - np.maximum(first[0], second[0])
        assert common.min() <= 0.0, (one, other)


@pytest.mark.parametrize(("birds", "fewest"), [(1, 1), (13, 13), (101, 15), (301, 15)])
def test_the_leader_and_both_ends_have_labels(birds: int, fewest: int) -> None:
    numbers = {shape.number for shape in labels(wedge(birds))}
    assert {1, birds // 2 + 1, birds} <= numbers
    assert len(numbers) >= fewest


def test_texts_of_a_wide_flock_are_larger() -> None:
    usual, wide = (next(labels(wedge(birds))).scale[2] for birds in (13, 101))
    assert usual == pytest.approx(0.3 * 0.8)  # b = 0.8 m
    # Their height is the same part of the width of the flock, whatever this is.
    wider = next(labels(wedge(201))).scale[2]
    assert 6.0 < wide / usual < 7.0
    assert wider / wide == pytest.approx(2.0, rel=0.02)


def test_a_bird_of_another_span_is_labelled_rather_than_its_neighbours() -> None:
    ratio = np.ones(101)
    ratio[6] = 0.98
    assert 7 in {shape.number for shape in labels(snapshot(ratio))}


def test_labels_say_what_is_saved() -> None:
    shown = snapshot()
    told = {shape.number: shape.text for shape in labels(shown)}
    assert told[3] == "3\n14.0 %"
    assert told == {bird: label_text(shown, bird) for bird in range(1, len(RATIO) + 1)}


def test_the_title_names_birds_time_and_mean() -> None:
    legend = {shape.number: shape for shape in legends(snapshot(), 1.5)}
    assert legend[0].text == "5 birds, t = 20 b/U_min\nmean drag saved 14.0 %"
    assert [legend[k].text for k in (10, 11)] == ["drag saved: 0 %", "30 %"]
    assert [legend[k].text for k in (20, 21)] == ["air: down 1.5 m/s", "up 1.5 m/s"]
    # Left is y > 0: the scales begin there.
    assert legend[10].origin[1] > legend[1].points[:, 1].max()
    assert legend[11].origin[1] < legend[1].points[:, 1].min()
