"""The spectrum of the contour error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from ffcomp.compare.result import Comparison, Method, Samples
from ffcomp.report.compare.off_path import contour_vectors, unbroken
from models.arrays import FloatArray

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


def resonance_band(found: Comparison) -> tuple[float, float] | None:
    """Return the lowest and highest frequency of the bed map where the evaluated part was printed, Hz."""
    if found.bed is None:
        return None
    here = _cells(found, found.methods["none"].samples)
    values = found.bed.frequency_hz[here[:, 1], here[:, 0]]
    if not np.isfinite(values).any():
        return None
    return float(np.nanmin(values)), float(np.nanmax(values))


def _cells(found: Comparison, samples: Samples) -> NDArray[np.int64]:
    """Return the points of the bed map that are nearest to the print, (k, 2): ix and iy."""
    assert found.bed is not None
    nearest = [
        np.abs(axis[:, None] - samples.reference[None, ::100, k]).argmin(axis=0)
        for k, axis in enumerate((found.bed.x_mm, found.bed.y_mm))
    ]
    return np.unique(np.column_stack(nearest), axis=0)
