# SPDX-License-Identifier: Apache-2.0
"""Decimation of a curve: the least and the largest value of each bucket of rows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray


def bucket_width(rows: int, most: int) -> int:
    """Return the number of rows per bucket, so that `rows` fit into `most` buckets.

    It is 1, without decimation, if there are at most two rows per bucket.
    """
    return 1 if rows <= 2 * most else -(-rows // most)


def extremes(values: FloatArray, width: int) -> FloatArray:
    """Return the least and the largest of every `width` rows, in their order in time.

    `values` has shape (rows, ...), the result (2 buckets, ...), or that of `values` if `width` is
    1. Non-finite values are left out. A bucket without finite values gives nan.
    """
    if width == 1:
        return np.where(np.isfinite(values), values, np.nan)
    rows = len(values)
    buckets = -(-rows // width)
    whole = np.full((buckets * width, *values.shape[1:]), np.nan)
    whole[:rows] = np.where(np.isfinite(values), values, np.nan)
    whole = whole.reshape(buckets, width, *values.shape[1:])
    unknown = np.isnan(whole)
    least = np.where(unknown, np.inf, whole).argmin(axis=1)
    largest = np.where(unknown, -np.inf, whole).argmax(axis=1)
    ends = np.stack([np.minimum(least, largest), np.maximum(least, largest)], axis=1)
    kept: FloatArray = np.take_along_axis(whole, ends, axis=1)
    return kept.reshape(2 * buckets, *values.shape[1:])


def ends(times: FloatArray, width: int) -> FloatArray:
    """Return the first and the last of every `width` times, at which `extremes` are drawn."""
    if width == 1:
        return times
    first = np.arange(0, len(times), width)
    last = np.minimum(first + width, len(times)) - 1
    drawn: FloatArray = times[np.stack([first, last], axis=1).ravel()]
    return drawn


def frame_rows(rows: int, most: int) -> npt.NDArray[np.int64]:
    """Return at most `most` of `rows` row numbers, with the first and the last.

    Row numbers grow with the square of their index, because most changes happen at the start.
    """
    reached = np.linspace(0.0, 1.0, min(most, rows))
    return np.unique(np.round((rows - 1) * reached**2).astype(np.int64))
