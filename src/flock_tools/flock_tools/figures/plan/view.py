# SPDX-License-Identifier: Apache-2.0
"""What is shown of a formation seen from above: the panels, each with a range along the flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flock_sim.analysis.metrics import Metrics
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.physics.arrays import BoolArray, FloatArray
from flock_tools.figures.parts import parts

_NARROWEST = 10.0
"""Least width that is shown, in b, so that a few birds are not drawn too large."""

_FARTHEST = 1e9
"""Largest distance of the view from the leader, in b: rounding moves no bird visibly there."""

_FARTHEST_PART = 1e6
"""Largest distance from the leader of a part that has a panel: its axis has all digits."""

_WIDEST = 0.25
"""Largest gap that a panel shows, over the width of the view; a larger one has a broken axis."""

_LONGEST, _SHORTEST = 0.5, 0.12
"""Largest and smallest height of the panel of a part, over the width of the view."""

_HIGHEST, _LOWEST = 1.0, 0.2
"""Largest and smallest height of the main panel, over the width of the view."""

_MOST_PANELS = 1.0
"""Largest sum of the heights of all other panels, over the width of the view."""

_BETWEEN = 0.045
"""Room between panels, over the width of the view."""

_BEHIND, _AHEAD = 1.4, 1.2
"""Room behind and ahead of the birds of a panel, in b."""

_LABELS = 0.03
"""Room for numbers and marks ahead of them, over the width of the view."""


@dataclass(frozen=True)
class PlanView:
    """One flock as it is drawn; arrays of shape (birds,), lengths in b from the leader."""

    across: FloatArray
    along: FloatArray
    start: FloatArray
    """`along` at the start of the flight."""
    span_ratio: FloatArray
    saved: FloatArray
    """Drag reduction, in %."""
    bottom: float
    top: float
    """Upper end of the range of the main panel along the flight; `bottom` is its lower end."""
    panels: tuple[tuple[float, float], ...]
    """The ranges of the other panels along the flight, from the last to the first."""

    @classmethod
    def of(cls, configuration: FlockConfiguration, metrics: Metrics, m: int) -> PlanView:
        """Return the view of the flock with index `m`.

        If the flock has come apart, the main panel is around the bird in the middle, or around the
        start if that bird is too far from the leader. The largest other parts have panels, too.
        """
        birds = configuration.birds
        start = np.array([formation.start_position(bird, birds) for bird in range(1, birds + 1)])
        along = metrics.position[m]
        across, span_ratio = metrics.lateral[m], configuration.span_ratio[:, m]
        width = _width(across, span_ratio)
        bottom, top = _main_panel(along, start, width)
        return cls(
            across=across,
            along=along,
            start=start,
            span_ratio=span_ratio,
            saved=100.0 * metrics.drag_reduction[m],
            bottom=bottom,
            top=top,
            panels=_other_panels(along, bottom, top, width),
        )

    @property
    def width(self) -> float:
        """Width of the view across the flight, in b."""
        return _width(self.across, self.span_ratio)

    @property
    def height(self) -> float:
        """Height of the main panel along the flight, in b."""
        return self.top - self.bottom

    @property
    def between(self) -> float:
        """Room between two panels, in b."""
        return _BETWEEN * self.width

    @property
    def above(self) -> float:
        """Height of the panels above the main one, in b, with the room between them."""
        return self._height(self.top, np.inf)

    @property
    def below(self) -> float:
        """Height of the panels below the main one, in b, with the room between them."""
        return self._height(-np.inf, self.bottom)

    def _height(self, low: float, high: float) -> float:
        """Return the height of the panels between two positions."""
        heights = [top - bottom for bottom, top in self.panels if low <= bottom and top <= high]
        return sum(heights) + self.between * len(heights)

    def within(self, bottom: float, top: float) -> BoolArray:
        """Return which birds a panel shows."""
        return (self.along >= bottom) & (self.along <= top)


def _width(across: FloatArray, span_ratio: FloatArray) -> float:
    flock = 2.0 * float((np.abs(across) + span_ratio).max())
    return max(_NARROWEST, 1.05 * flock + 1.0)


def _main_panel(along: FloatArray, start: FloatArray, width: float) -> tuple[float, float]:
    """Return the range of the panel around the bird in the middle, and the birds next to it."""
    there = along[np.isfinite(along)]
    middle = formation.middle_position(there) if len(there) else 0.0
    if abs(middle) > _FARTHEST:
        middle = 0.0
    places = np.append(there, start)
    shown = places[np.abs(places - middle) <= np.ptp(start) + 3.0]
    low, high = float(shown.min()), float(shown.max())
    for place in sorted(there, key=lambda place: abs(place - middle)):
        wider = min(low, place), max(high, place)
        near = low - place <= _WIDEST * width and place - high <= _WIDEST * width
        if near and wider[1] - wider[0] <= _HIGHEST * width:
            low, high = wider
    room = max(0.0, _LOWEST * width - (high - low) - _BEHIND - _AHEAD)
    return low - _BEHIND - 0.5 * room, high + _AHEAD + _LABELS * width + 0.5 * room


def _other_panels(
    along: FloatArray, bottom: float, top: float, width: float
) -> tuple[tuple[float, float], ...]:
    """Return the ranges of panels of the birds outside of the main one, the largest parts first."""
    with np.errstate(invalid="ignore"):
        outside = ((along < bottom) | (along > top)) & (np.abs(along) <= _FARTHEST_PART)
    found = parts(np.where(outside, along, np.nan), _WIDEST * width, _LONGEST * width)
    panels: list[tuple[float, float]] = []
    for part in sorted(found, key=len, reverse=True):
        low, high = float(along[part].min()) - _BEHIND, float(along[part].max()) + _AHEAD
        high += _LABELS * width
        room = 0.5 * max(0.0, _SHORTEST * width - (high - low))
        panel = low - room, high + room
        others = (*panels, (bottom, top))
        free = all(panel[1] <= other[0] or other[1] <= panel[0] for other in others)
        height = sum(high - low for low, high in (*panels, panel))
        if free and height <= _MOST_PANELS * width:
            panels.append(panel)
    return tuple(sorted(panels))
