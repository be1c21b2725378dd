# SPDX-License-Identifier: Apache-2.0
"""The scene of a flock agrees with the physics, to scale."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.types import ENCAPSULATION
from flock_sim.physics import formation
from flock_sim.physics.flock_state import FlockState
from flock_sim.physics.scaling import Scales
from flock_tools.figures.bird_outline import RIGHT_HALF
from flock_tools.figures.style import DRAG_SAVED
from flock_tools.scene import wake
from flock_tools.scene.bird_mesh import BIRD, SHADE
from flock_tools.scene.frame import TOPICS, Frame
from flock_tools.scene.marker import UPWASH, Kind, Shape
from flock_tools.scene.shapes import Scene, scene
from flock_tools.scene.snapshot import Snapshot

RATIO = np.array([0.9, 1.0, 1.1, 1.0, 0.8])


def snapshot(
    ratio: np.ndarray = RATIO, stamp: tuple[int, int] = (1, 2), **changed: object
) -> Snapshot:
    """A snapshot of one flock; `changed` are fields of its state."""
    birds = len(ratio)
    configuration = FlockConfiguration(birds=birds, wing_span=1.6, min_drag_speed=17.0)
    scales = Scales.of(configuration)
    state = FlockState(
        step=20,
        time=20.0,
        position=1000.0 - 1.5 * np.abs(np.arange(birds) - birds // 2),
        speed=np.full(birds, 1.2),
        circulation=scales.circulation_min * ratio**2 / 1.2,
        interaction_drag=-scales.cruise_drag * np.linspace(0.0, 0.28, birds),
        mean_speed=np.full(birds, 1.2),
        mean_interaction_drag=np.zeros(birds),
    )
    return Snapshot(configuration, 0, 1, stamp, replace(state, **changed), ratio)


def group(shown: Scene, name: str) -> list[Shape]:
    return [shape for shape in shown.shapes if shape.group == name]


def test_a_bird_is_as_wide_as_its_outline_and_has_its_area() -> None:
    tips = BIRD[..., 1]
    assert (tips.min(), tips.max()) == (-1.0, 1.0)
    x, y = RIGHT_HALF.T
    shoelace = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    edges = BIRD[:16, 1:, :2] - BIRD[:16, :1, :2]
    areas = 0.5 * np.abs(np.linalg.det(edges))
    assert areas.sum() == pytest.approx(2.0 * shoelace, rel=1e-12)


def test_birds_have_their_true_span_and_place_in_metres() -> None:
    shown = snapshot()
    birds = group(scene(shown), "birds")
    lateral = formation.lateral_positions(RATIO[:, np.newaxis])[:, 0]
    assert [shape.number for shape in birds] == [1, 2, 3, 4, 5]
    for i, shape in enumerate(birds):
        assert np.ptp(shape.points[:, 1]) == pytest.approx(1.6 * RATIO[i], rel=1e-12)
        assert shape.origin[0] == pytest.approx(-1.5 * abs(i - 2) * 0.8, abs=1e-12)
        assert shape.origin[1] == pytest.approx(-0.8 * lateral[i], abs=1e-12)  # y is to the left
    assert shown.origin == 1000.0
    # REP 103: y is to the left, and bird 1 flies at the end of the left wing.
    assert lateral[0] < 0.0 < birds[0].origin[1]


def test_birds_are_coloured_by_the_drag_they_save() -> None:
    birds = group(scene(snapshot()), "birds")
    for saved, shape in zip([0.0, 7.0, 14.0, 21.0, 28.0], birds, strict=True):
        expected = DRAG_SAVED(saved / 30.0)[:3] * SHADE[:, np.newaxis]  # 30 %: end of the scale
        # The table of colours has 256: rounding may take the next one.
        assert shape.colours[::3, :3] == pytest.approx(expected, abs=0.02)
        assert (shape.colours[:, 3] == 1.0).all()


def test_the_wake_of_one_bird_goes_down_inside_of_its_vortices_and_up_outside() -> None:
    air = wake.Vortices(np.zeros(1), np.zeros(1), np.ones(1), np.array([0.1]))
    point, upwash = wake.ribbons(air, -10.0)
    inside = np.abs(point[..., 1]) < pi / 4.0
    assert (upwash[inside] < 0.0).all()
    assert (upwash[~inside] > 0.0).all()
    assert 0 < inside.sum() < inside.size
    # The plane of the wings, Eqs. (vz0) and (vzpm), with a = pi / 4.
    x, y, a = -point[..., 0], point[..., 1], pi / 4.0
    right, left = np.hypot(x, y + a), np.hypot(x, y - a)
    paper = ((y + a) / right - (y - a) / left) / x
    paper += (1.0 + x / right) / (a + y) + (1.0 + x / left) / (a - y)
    assert upwash == pytest.approx(-0.1 / (4.0 * pi) * paper, rel=1e-9)
    assert air.far_downwash == pytest.approx(0.1 / (pi * a), rel=1e-12)


def test_ribbons_lie_side_by_side_and_end_in_the_plane() -> None:
    shown = snapshot()
    air = wake.Vortices(shown.along, shown.lateral, shown.span_ratio, shown.state.circulation)
    end = wake.plane(air).position
    point, upwash = wake.ribbons(air, end)
    left, right = point[:, 0, 0, 1], point[:, 0, -1, 1]
    assert right[:-1] == pytest.approx(left[1:], abs=1e-12)
    assert point[:, -1, :, 0] == pytest.approx(end)
    assert np.isfinite(upwash).all()


def test_ribbons_are_coloured_by_where_the_air_goes() -> None:
    down, up = np.array(UPWASH(0.0)), np.array(UPWASH(1.0))
    assert down[0] == down[1] or abs(down[0] - down[1]) < 0.02  # grey
    assert up[0] > 2.0 * up[1]  # red
    (ribbon,) = group(scene(snapshot(np.ones(1))), "wakes")
    outside = np.abs(ribbon.points[:, 1]) > 0.8 * pi / 4.0
    redness = ribbon.colours[:, 0] - ribbon.colours[:, 1]
    assert (redness[outside] > 0.0).all()
    assert (redness[~outside] < 0.02).all()


def test_rising_air_is_darker_than_sinking_air_in_grey_print() -> None:
    lightness = UPWASH(np.linspace(0.0, 1.0, 64))[:, :3] @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(lightness) < 0.0).all()
    assert lightness[0] > 0.9
    assert lightness[-1] < 0.15


def test_a_plane_of_more_rows_has_finer_cells_in_the_same_place() -> None:
    (usual,), (fine,) = (
        group(scene(snapshot(), rows=rows), "upwash") for rows in (wake.PLANE_ROWS, 48)
    )
    assert len(fine.points) == 4 * len(usual.points)
    assert fine.scale[2] == pytest.approx(0.5 * usual.scale[2])
    reach = [np.abs(plane.points[:, 2]).max() + 0.5 * plane.scale[2] for plane in (usual, fine)]
    assert reach[0] == pytest.approx(reach[1])


def test_the_plane_is_behind_the_flock_and_the_image_is_its_upwash_in_si_units() -> None:
    shown = snapshot()
    result = scene(shown)
    (cubes,) = group(result, "upwash")
    assert cubes.kind == Kind.CUBES
    x = 0.8 * (shown.along.min() - wake.PLANE_BEHIND)
    assert cubes.points[:, 0] == pytest.approx(x)
    rows, columns = result.upwash.shape
    assert len(cubes.points) == rows * columns
    air = wake.Vortices(shown.along, shown.lateral, shown.span_ratio, shown.state.circulation)
    for k in (0, 77, rows * columns - 1):
        place = cubes.points[k] / 0.8 * (1.0, -1.0, 1.0)
        assert result.upwash.flat[k] == pytest.approx(17.0 * float(air.upwash(place)), rel=1e-5)
    # From behind: the first row is the uppermost, the first column that of the left wing.
    assert cubes.points[0, 2] > cubes.points[-1, 2]
    assert cubes.points[0, 1] > cubes.points[columns - 1, 1]


def test_trails_show_the_way_in_the_formation() -> None:
    shown = snapshot()
    before = [shown.along - 2.0, shown.along - 1.0]
    trails = group(scene(shown, before), "trails")
    assert [trail.number for trail in trails] == [1, 2, 3, 4, 5]
    x = 0.8 * shown.along[1]
    assert trails[1].points[:, 0] == pytest.approx([x - 1.6, x - 0.8, x])
    assert (np.diff(trails[1].colours[:, 3]) > 0.0).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("lost", [[0], [2], [1, 3], [0, 1, 2, 3, 4]])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_birds_that_are_nowhere_are_left_out(lost: list[int], value: float) -> None:
    position = snapshot().state.position.copy()
    position[lost] = value
    shown = scene(snapshot(position=position))
    there = [i + 1 for i in range(5) if i not in lost]
    assert [shape.number for shape in group(shown, "birds")] == there
    assert [shape.number for shape in group(shown, "wakes")] == there
    for shape in shown.shapes:
        assert np.isfinite(shape.points).all()
        assert np.isfinite(shape.colours).all()
        assert np.isfinite(shape.origin).all()
    assert np.isfinite(shown.upwash).all()


def test_the_plane_does_not_follow_a_bird_that_is_left_behind() -> None:
    position = snapshot().state.position.copy()
    position[0] -= 5000.0
    (cubes,) = group(scene(snapshot(position=position)), "upwash")
    assert cubes.points[0, 0] > -10.0


@pytest.mark.parametrize(
    "changed",
    [
        {"circulation": np.array([-1.0, -2.0, -1.0, -1.0, -1.0])},
        {"circulation": np.zeros(5)},
        {"circulation": np.full(5, 1e308)},
        {"circulation": np.array([1.0, np.nan, np.inf, 1.0, 1.0])},
        {"position": np.array([1e308, -1e308, 0.0, 1e18, np.nan])},
        {"position": np.full(5, np.inf)},
        {"interaction_drag": np.array([np.nan, np.inf, -np.inf, 1e308, 0.0])},
        {"time": np.nan, "stamp": (-5, 2**32 - 1)},
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_whatever_states_say_is_shown_or_left_out(changed: dict[str, object]) -> None:
    told = snapshot(**changed)
    frame = Frame(told, [told.along, snapshot().along], anew=True)
    for topic in TOPICS.values():
        data = topic.message(frame)
        assert data.startswith(ENCAPSULATION)
