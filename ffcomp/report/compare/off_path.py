"""The contour error with a direction: from the reference path to the nozzle."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ffcomp.compare.result import Samples
from ffcomp.metrics import offset_from_path
from models.arrays import FloatArray

GAP_S = 0.3  # samples further apart in the reference plan than this are not neighbours: the print was sampled
LATE_S, EARLY_S = 0.0125, 0.005  # the nearest part of the path was due this long before, or will be this long after


def unbroken(due: FloatArray) -> list[slice]:
    """Return the intervals of times (m,) s without a gap."""
    steps = np.diff(due)
    cuts = [0, *(np.flatnonzero((steps > GAP_S) | (steps < 0.0)) + 1).tolist(), len(due)]
    return [slice(a, b) for a, b in pairwise(cuts)]


def contour_vectors(samples: Samples, sample_s: float) -> FloatArray:
    """Return vectors (m, 3) mm, as long as the contour error, from the nearest point of the path to the nozzle.

    The direction is taken from the sampled path, the length from the exact one: the first may be off by what a chord
    of one sample cuts from a corner, the second is the table's.
    """
    away = np.empty_like(samples.nozzle)
    late, early = round(LATE_S / sample_s), round(EARLY_S / sample_s)
    for piece in unbroken(samples.due):
        away[piece] = _away(
            np.ascontiguousarray(samples.reference[piece]), np.ascontiguousarray(samples.nozzle[piece]), late, early
        )
    length = np.linalg.norm(away, axis=1)
    return np.asarray(away * (samples.contour / np.maximum(length, 1e-12))[:, None])


def _away(reference: FloatArray, nozzle: FloatArray, late: int, early: int) -> FloatArray:
    """Return the vectors (k, 3) from the nearest of the chords i - late … i + early of the sampled path to sample i."""
    if len(reference) < 2:
        return nozzle - reference
    i, chords = np.arange(len(nozzle)), len(reference) - 1
    away: FloatArray = offset_from_path(
        reference, nozzle, np.clip(i - late, 0, chords - 1), np.minimum(i + early + 1, chords)
    )
    return away
