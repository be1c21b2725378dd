# SPDX-License-Identifier: Apache-2.0
"""The picture of the upwash has the colours of the plane, and says what they mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flock_tools.scene.marker import UPWASH
from flock_tools.scene.shapes import scene
from flock_tools.scene.upwash_image import LEAST_WIDTH, LEGEND, upwash_image
from unit.scene.test_shapes import RATIO, group, snapshot


@pytest.mark.parametrize("ratio", [np.ones(1), RATIO, np.ones(31)])
def test_cells_have_the_colours_of_the_plane_from_the_top_left(ratio: np.ndarray) -> None:
    shown = scene(snapshot(ratio))
    picture = upwash_image(shown)
    rows, columns = shown.upwash.shape
    side = picture.shape[1] // columns
    assert picture.shape == (rows * side + LEGEND, columns * side, 3)
    assert picture.shape[1] >= LEAST_WIDTH
    (plane,) = group(shown, "upwash")
    middles = picture[side // 2 : rows * side : side, side // 2 :: side]
    expected = 255.0 * plane.colours[:, :3].reshape(rows, columns, 3)
    assert middles == pytest.approx(expected, abs=3.0)  # a neighbouring one of 256 colours


def test_the_legend_of_a_diverged_flock_has_its_usual_size() -> None:
    shown = scene(snapshot())
    usual = upwash_image(shown)
    for most in (1e5, 1e300, np.inf):
        assert upwash_image(replace(shown, most_upwash=most)).shape == usual.shape


def test_the_legend_has_the_scale_between_its_ends() -> None:
    shown = scene(snapshot())
    strip = upwash_image(shown)[-LEGEND:]
    row = strip[LEGEND // 2].astype(int)
    down, up = (np.array(UPWASH(end, bytes=True)[:3], dtype=int) for end in (0.0, 1.0))
    first = np.flatnonzero((row == down).all(axis=1))[0]
    last = np.flatnonzero((row == up).all(axis=1))[-1]
    assert last - first > LEAST_WIDTH // 3
    assert (np.diff(row[first:last, 1]) <= 0).all()
    for side in (strip[:, :first], strip[:, last + 1 :]):  # the letters
        assert side.min() < 60
        assert np.median(side) == 255


def test_the_legend_says_the_speed_at_its_end() -> None:
    slow, fast = (scene(snapshot(circulation=c * np.ones(5))) for c in (0.1, 0.2))
    assert fast.most_upwash == pytest.approx(2.0 * slow.most_upwash)
    one, other = upwash_image(slow)[-LEGEND:], upwash_image(fast)[-LEGEND:]
    assert one.shape == other.shape
    assert (one != other).any()


def test_a_flock_without_air_has_a_picture() -> None:
    picture = upwash_image(scene(snapshot(position=np.full(5, np.nan))))
    assert picture.shape == (LEAST_WIDTH + LEGEND, LEAST_WIDTH, 3)
