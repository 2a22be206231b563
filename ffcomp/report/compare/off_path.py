"""The contour error with a direction: from the wanted path to the nozzle."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numba import njit

from ffcomp.compare.result import Samples
from models.arrays import FloatArray

GAP_S = 0.3  # samples further apart in the wanted plan than this are not neighbours: the print was sampled
LATE_S, EARLY_S = 0.0125, 0.005  # the nearest part of the path was due this long before, or will be this long after


def unbroken(due: FloatArray) -> list[slice]:
    """Pieces of (m,) s without a gap."""
    steps = np.diff(due)
    cuts = [0, *(np.flatnonzero((steps > GAP_S) | (steps < 0.0)) + 1).tolist(), len(due)]
    return [slice(a, b) for a, b in pairwise(cuts)]


def contour_vectors(samples: Samples, sample_s: float) -> FloatArray:
    """(m, 3) mm, as long as the contour error, from the nearest point of the wanted path to the nozzle.

    The direction is taken from the sampled path, the length from the exact one: the first may be off by what a chord
    of one sample cuts from a corner, the second is the table's.
    """
    away = np.empty_like(samples.nozzle)
    late, early = round(LATE_S / sample_s), round(EARLY_S / sample_s)
    for piece in unbroken(samples.due):
        away[piece] = _away(
            np.ascontiguousarray(samples.wanted[piece]), np.ascontiguousarray(samples.nozzle[piece]), late, early
        )
    length = np.linalg.norm(away, axis=1)
    return np.asarray(away * (samples.contour / np.maximum(length, 1e-12))[:, None])


@njit(cache=True, nogil=True)
def _away(wanted: FloatArray, nozzle: FloatArray, late: int, early: int) -> FloatArray:
    """(k, 3) from the nearest of the chords i - late … i + early of the sampled path to the nozzle at sample i."""
    found = nozzle - wanted
    for i in range(len(nozzle)):
        best = found[i, 0] ** 2 + found[i, 1] ** 2 + found[i, 2] ** 2
        for k in range(max(i - late, 0), min(i + early + 1, len(wanted) - 1)):
            x, y, z = wanted[k, 0], wanted[k, 1], wanted[k, 2]
            ux, uy, uz = wanted[k + 1, 0] - x, wanted[k + 1, 1] - y, wanted[k + 1, 2] - z
            dx, dy, dz = nozzle[i, 0] - x, nozzle[i, 1] - y, nozzle[i, 2] - z
            length2 = ux * ux + uy * uy + uz * uz
            along = min(1.0, max(0.0, (ux * dx + uy * dy + uz * dz) / length2)) if length2 > 0.0 else 0.0
            dx, dy, dz = dx - along * ux, dy - along * uy, dz - along * uz
            distance2 = dx * dx + dy * dy + dz * dz
            if distance2 < best:
                best = distance2
                found[i, 0], found[i, 1], found[i, 2] = dx, dy, dz
    return found
