# SPDX-License-Identifier: Apache-2.0
"""The largest value of functions of frequency, refined to rounding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray

Curves = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""A function of frequencies that returns values and slopes, both (frequencies, curves)."""

MOST_STEPS = 100

CLOSE = 4.0 * float(np.finfo(float).eps)
"""Width of a bracket, relative to its upper end, at which a maximum is found."""


@dataclass(frozen=True)
class Peaks:
    """The largest values of curves, shape (curves,), and their frequencies."""

    value: FloatArray
    frequency: FloatArray


def peaks(curves: Curves, omega: FloatArray, values: FloatArray, slopes: FloatArray) -> Peaks:
    """Return the largest values of `curves`.

    `values` and `slopes` are those at ascending `omega`, both (frequencies, curves). A curve has a
    maximum between two frequencies where its slope changes from above 0 to below 0. Maxima that may
    be the largest, by the crossing of the tangents, are refined to the zero of the slope.
    """
    columns = np.arange(values.shape[1])
    first = np.argmax(values, axis=0)
    best, where = values[first, columns].copy(), omega[first].copy()
    interval, curve = np.nonzero((slopes[:-1] > 0.0) & (slopes[1:] < 0.0))
    low, high = omega[interval], omega[interval + 1]
    low_value, high_value = values[interval, curve], values[interval + 1, curve]
    low_slope, high_slope = slopes[interval, curve], slopes[interval + 1, curve]
    with np.errstate(invalid="ignore"):
        crossing = (high_value - low_value + low_slope * low - high_slope * high) / (
            low_slope - high_slope
        )
        bound = low_value + low_slope * (np.clip(crossing, low, high) - low)
    bound = np.maximum(bound, np.maximum(low_value, high_value))
    hopeful = bound >= best[curve]
    interval, curve = interval[hopeful], curve[hopeful]
    place, value = _zeros(
        curves, curve, low[hopeful], high[hopeful], low_slope[hopeful], high_slope[hopeful]
    )
    for k in np.argsort(value, kind="stable"):
        if value[k] >= best[curve[k]]:
            best[curve[k]], where[curve[k]] = value[k], place[k]
    return Peaks(best, where)


def _zeros(
    curves: Curves,
    curve: npt.NDArray[np.int64],
    low: FloatArray,
    high: FloatArray,
    low_slope: FloatArray,
    high_slope: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the zeros of slopes in brackets, one for each entry of `curve`, and the values there.

    All brackets are refined together, by the method of Ridders: each step halves a bracket, and
    goes on to the zero of the exponential function that fits its three slopes.
    """
    place = 0.5 * (low + high)
    value = np.full(len(place), -np.inf)
    open_ = np.arange(len(place))
    for _ in range(MOST_STEPS):
        if not len(open_):
            break
        middle = 0.5 * (low[open_] + high[open_])
        rows = np.arange(len(open_))
        slope = curves(middle)[1][rows, curve[open_]]
        a, b = low_slope[open_], high_slope[open_]
        step = 0.5 * (high[open_] - low[open_]) * slope / np.sqrt(slope * slope - a * b)
        following = middle + step  # a > 0 > b
        values, slopes = curves(following)
        newest = slopes[rows, curve[open_]]
        moved = np.abs(following - place[open_])
        place[open_], value[open_] = following, values[rows, curve[open_]]
        for at, tilt in ((middle, slope), (following, newest)):
            rising = (tilt > 0.0) & (at > low[open_])
            falling = (tilt <= 0.0) & (at < high[open_])
            low[open_[rising]], low_slope[open_[rising]] = at[rising], tilt[rising]
            high[open_[falling]], high_slope[open_[falling]] = at[falling], tilt[falling]
        narrow = high[open_] - low[open_] <= CLOSE * high[open_]
        open_ = open_[~(narrow | (moved <= CLOSE * following) | (newest == 0.0))]
    return place, value
