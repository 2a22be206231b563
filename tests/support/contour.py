"""Contour error where no clock can be trusted: by the order in which the path is passed."""

from __future__ import annotations

import numpy as np

from ffcomp.metrics import distance_to_path, progress_in_order
from models.arrays import FloatArray, IntArray

NEAR_MM = 0.1  # of a path around the place where a sample is, within which its nearest segment is sought


def contour_error_in_order(
    path: FloatArray, nozzle: FloatArray, low: IntArray | None = None, high: IntArray | None = None
) -> FloatArray:
    """The distance (m,) mm of each sample (m, 3) to the path (n + 1, 3), of its segments low ≤ k < high."""
    m, n = len(nozzle), len(path) - 1
    low = np.zeros(m, dtype=np.int64) if low is None else low
    high = np.full(m, n, dtype=np.int64) if high is None else high
    segment, share = progress_in_order(path, nozzle, low, high)
    begins = np.concatenate([[0.0], np.cumsum(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1)))])
    at = begins[segment] + share * np.diff(begins)[segment]
    first = np.minimum(np.searchsorted(begins[1:], at - NEAR_MM), segment)
    last = np.maximum(np.searchsorted(begins[:-1], at + NEAR_MM), segment + 1)
    bounds = np.maximum(first, low), np.minimum(last, np.maximum(high, low + 1))
    return distance_to_path(np.ascontiguousarray(path), np.ascontiguousarray(nozzle), *bounds)
