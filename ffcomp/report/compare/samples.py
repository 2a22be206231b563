"""Error vectors and their spectrum, from an evaluated method's samples."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from ffcomp.comparison.result import Comparison, Method, Samples
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


WINDOW_S = 0.8  # of one Welch segment: lines 1.25 Hz apart
HIGHEST_HZ = 160.0  # nothing rings above it that a print would show


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A one-sided density; its integral over all frequencies is the mean square of the contour error."""

    frequency_hz: FloatArray  # (n,)
    density_um2_per_hz: FloatArray  # (n,)


def spectrum(method: Method, sample_s: float) -> Spectrum | None:
    """Return Welch's mean over all unbroken intervals, weighted by their lengths; None if all are too short.

    The contour error as a vector, from the path to the nozzle: its mean square is that of the table.
    """
    pieces = [piece for piece in unbroken(method.samples.due) if piece.stop - piece.start >= 32]
    window = min(round(WINDOW_S / sample_s), max((p.stop - p.start for p in pieces), default=0))
    pieces = [piece for piece in pieces if piece.stop - piece.start >= window]
    if not pieces:
        return None
    error = 1e3 * contour_vectors(method.samples, sample_s)
    total: FloatArray = np.zeros(window // 2 + 1)
    for piece in pieces:
        f, density = welch(error[piece], fs=1 / sample_s, nperseg=window, axis=0, detrend=False)
        total += density.sum(axis=1) * (piece.stop - piece.start)
    total /= sum(piece.stop - piece.start for piece in pieces)
    keep = f <= HIGHEST_HZ
    return Spectrum(f[keep], total[keep])


def resonance_band(comparison: Comparison) -> tuple[float, float] | None:
    """Return the lowest and highest frequency of the bed map where the evaluated part was printed, Hz."""
    if comparison.bed is None:
        return None
    here = _cells(comparison, comparison.methods["none"].samples)
    values = comparison.bed.frequency_hz[here[:, 1], here[:, 0]]
    if not np.isfinite(values).any():
        return None
    return float(np.nanmin(values)), float(np.nanmax(values))


def _cells(comparison: Comparison, samples: Samples) -> NDArray[np.int64]:
    """Return the points of the bed map that are nearest to the print, (k, 2): ix and iy."""
    assert comparison.bed is not None
    nearest = [
        np.abs(axis[:, None] - samples.reference[None, ::100, k]).argmin(axis=0)
        for k, axis in enumerate((comparison.bed.x_mm, comparison.bed.y_mm))
    ]
    return np.unique(np.column_stack(nearest), axis=0)
