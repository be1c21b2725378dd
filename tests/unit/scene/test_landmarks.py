# SPDX-License-Identifier: Apache-2.0
"""The bar of a picture has a round length, and the arrow points along the flight."""

from __future__ import annotations

import numpy as np
import pytest

from flock_tools.scene.landmarks import AHEAD, LEAST, PART, Landmarks, round_length

PLACE = np.array([[-3.0, 5.0, 0.0], [1.0, 0.0, 0.0], [-2.0, -45.0, 0.0]])


def test_the_bar_is_across_the_flight_ahead_of_the_birds_and_as_long_as_it_says() -> None:
    marks = Landmarks.ahead_of(PLACE, 0.75)
    assert marks.length == 10.0
    assert marks.length <= PART * (50.0 + 2.0 * 0.75)
    assert np.ptp(marks.bar, axis=0).tolist() == [0.0, 10.0, 0.0]
    assert marks.bar[:, 0].tolist() == [1.0 + AHEAD * 0.75] * 2
    assert marks.bar[:, 1].mean() == pytest.approx(-20.0)


def test_the_arrow_begins_at_the_bar_and_points_forward() -> None:
    marks = Landmarks.ahead_of(PLACE, 0.75)
    assert marks.arrow[0].tolist() == marks.bar.mean(axis=0).tolist()
    assert np.diff(marks.arrow, axis=0).tolist() == [[10.0, 0.0, 0.0]]
    assert marks.head[1].tolist() == marks.arrow[1].tolist()
    assert (marks.head[[0, 2], 0] < marks.arrow[1, 0]).all()
    assert len(marks.points) == 4


def test_a_single_bird_has_a_bar_of_about_its_span() -> None:
    marks = Landmarks.ahead_of(np.zeros((1, 3)), 0.75)
    assert marks.length == 1.0 <= LEAST * 0.75


@pytest.mark.parametrize(
    ("most", "length"),
    [(0.9, 0.5), (1.0, 1.0), (1.99, 1.0), (2.0, 2.0), (4.9, 2.0), (5.0, 5.0), (99.0, 50.0)],
)
def test_lengths_are_1_2_or_5_times_a_power_of_ten(most: float, length: float) -> None:
    assert round_length(most) == pytest.approx(length, rel=1e-12)
