# SPDX-License-Identifier: Apache-2.0
"""Fewer numbers that draw the same curve: of each bucket of rows the least and the largest."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from flock_sim.core.kernel import FloatArray


def bucket_width(rows: int, most: int) -> int:
    """Return how many of `rows` go into a bucket, so that `most` buckets are enough.

    1, each row by itself, where there are no more rows than two for each bucket.
    """
    return 1 if rows <= 2 * most else -(-rows // most)


def extremes(values: FloatArray, width: int) -> FloatArray:
    """Return the least and the largest of every `width` rows, in the order in which they came.

    `values` has shape (rows, ...), the result (2 buckets, ...), or that of `values` where `width`
    is 1. What is not finite counts only where a bucket has nothing else: then it is nan.
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
    """Return the first and the last of every `width` times: where `extremes` are drawn."""
    if width == 1:
        return times
    first = np.arange(0, len(times), width)
    last = np.minimum(first + width, len(times)) - 1
    return times[np.stack([first, last], axis=1).ravel()]


def frame_rows(rows: int, most: int) -> npt.NDArray[np.int64]:
    """Return `most` of `rows` row numbers or fewer, first and last among them.

    They grow further apart with the square of their number: at the start most happens.
    """
    reached = np.linspace(0.0, 1.0, min(most, rows))
    return np.unique(np.round((rows - 1) * reached**2).astype(np.int64))
