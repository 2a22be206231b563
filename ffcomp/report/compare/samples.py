"""What is made of an evaluated method's samples: error vectors, their spectrum, and the viewer's packed points.

The viewer's points are thinned out, in few bytes, as base64. Points on a straight line between their neighbours, in
the reference path and in the error alike, go first; each point that stays has the largest error of those it stands for,
so that no peak is lost. All are whole numbers, see `COLUMNS`. Of each column the steps from point to point are written,
first the low bytes of all of them, then the next ones, so that zlib finds much to leave out: 9 bytes a point of 20.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from ffcomp.comparison.result import Comparison, Method, Outline, Samples
from ffcomp.metrics import offset_from_path
from ffcomp.report.compare.words import feature_errors, layer_errors, nick, rms_um, shown
from models.arrays import BoolArray, FloatArray, IntArray

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


POINTS = 240_000  # of all methods together: some 2.9 MB of text
OUTLINE_MOVES = 60_000
ERROR_WEIGHT = 20.0  # an error counts so much more than the same length along the path
FINEST_MM = 1e-4  # what bends less is straight
LOWEST_UM = 0.1  # end of the scale of errors
COLUMNS = (
    ("foot", "<u2", 3),  # × grain_mm + origin_mm: the nearest point of the reference path
    ("away", "<i2", 3),  # × step_mm: from there to the nozzle
    ("due", "<u4", 1),  # × DUE_S
    ("layer", "<u2", 1),  # index into the evaluated layers
    ("error", "u1", 1),  # logarithmic, LOWEST_UM at 0, highest_um at 255
    ("kind", "u1", 1),  # feature, + EXTRUDING, + BREAK
)
DUE_S = 1e-4
EXTRUDING, BREAK, FEATURES = 128, 64, 63  # plastic flows; not joined with the point before; the last feature


@dataclass(frozen=True, slots=True)
class Scale:
    """The conversion of numbers to integers, the same for all methods."""

    origin_mm: FloatArray  # (3,)
    grain_mm: float
    step_mm: float
    highest_um: float


@dataclass(frozen=True, eq=False)
class Trace:
    """One method's samples as they are drawn."""

    method: Method
    foot: FloatArray  # (m, 3) mm
    away: FloatArray  # (m, 3) mm


def packed(comparison: Comparison) -> dict[str, Any]:
    """Return the viewer's data, ready for JSON."""
    traces = [_trace(method, comparison.sample_s) for method in shown(comparison)]
    outline = _outline(comparison)
    scale = _scale(traces, outline)
    return {
        "origin": scale.origin_mm.tolist(),
        "grain": scale.grain_mm,
        "step": scale.step_mm,
        "tick": DUE_S,
        "lowest": LOWEST_UM,
        "highest": scale.highest_um,
        "features": list(comparison.features[: FEATURES + 1]),
        "partial": not comparison.whole,
        "layers": [{"number": layer.number, "z": layer.z_mm} for layer in comparison.layers],
        "reach": None if comparison.bed is None or not comparison.bed.is_round else float(comparison.bed.x_mm[-1]),
        "outline": _packed_outline(outline, scale),
        "methods": [_method(comparison, trace, scale, POINTS // len(traces)) for trace in traces],
    }


def _trace(method: Method, sample_s: float) -> Trace:
    away = contour_vectors(method.samples, sample_s)
    return Trace(method, method.samples.nozzle - away, away)


def thinned_out(comparison: Comparison) -> str:
    """State what the viewer leaves out; empty if nothing."""
    share = min(1.0, POINTS / sum(len(method.samples.due) for method in shown(comparison)))
    if share == 1.0:
        return ""
    return (
        f"The view holds {share:.0%} of the samples: those on straight lines between others are left out, and each "
        "that stays is coloured by the largest error of those it stands for."
    )


def _outline(comparison: Comparison) -> Outline:
    """Return what the print extrudes; of a large print every second, third, … layer, for it is only background."""
    none: Outline = Outline(*(np.empty((0, 3)),) * 2, *(np.empty(0, dtype=np.int64),) * 2)
    outline = comparison.outline or none
    every = -(-len(outline.layer) // OUTLINE_MOVES)
    kept = outline.layer % max(every, 1) == 0
    return Outline(outline.start[kept], outline.end[kept], outline.layer[kept], outline.feature[kept])


def _packed_outline(outline: Outline, scale: Scale) -> dict[str, Any]:
    """Chain the moves: a point where each ends, and one before it, which nothing joins, where it does not go on."""
    parted = np.append(True, np.any(outline.start[1:] != outline.end[:-1], axis=1))[: len(outline.layer)]
    at = np.flatnonzero(parted)
    points = np.insert(outline.end, at, outline.start[at], axis=0)
    kind = np.insert(np.minimum(outline.feature, FEATURES), at, BREAK)
    columns = (
        (np.round((points - scale.origin_mm) / scale.grain_mm), "<u2"),
        (np.insert(outline.layer, at, outline.layer[at]), "<u2"),
        (kind, "u1"),
    )
    return {"count": len(points), "data": _deflated(b"".join(_steps(column.astype(form)) for column, form in columns))}


def _deflated(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def _scale(traces: list[Trace], outline: Outline) -> Scale:
    corners = [trace.foot for trace in traces] + [each for each in (outline.start, outline.end) if len(each)]
    low = np.min([each.min(axis=0) for each in corners], axis=0)
    high = np.max([each.max(axis=0) for each in corners], axis=0)
    longest = max(float(np.abs(trace.away).max()) for trace in traces)
    highest = 1e3 * max(float(trace.method.samples.contour.max()) for trace in traces)
    return Scale(low, max(float((high - low).max()), 1.0) / 65535, max(longest, 1e-3) / 32767, max(highest, 1.0))


def _method(comparison: Comparison, trace: Trace, scale: Scale, limit: int) -> dict[str, Any]:
    method, s = trace.method, trace.method.samples
    numbers = [layer.number for layer in comparison.layers]
    layers, features = layer_errors(comparison, method), feature_errors(comparison, method)
    kept, joined = thin(trace, limit)
    worst = np.maximum.reduceat(s.contour, kept)
    layer_of = {number: index for index, number in enumerate(numbers)}
    columns = {
        "foot": np.round((trace.foot[kept] - scale.origin_mm) / scale.grain_mm),
        "away": np.round(trace.away[kept] / scale.step_mm),
        "due": np.round(s.due[kept] / DUE_S),
        "layer": [layer_of[number] for number in s.layer[kept].tolist()],
        "error": np.round(255 * log_share(1e3 * worst, scale.highest_um)),
        "kind": np.minimum(s.feature[kept], FEATURES) + EXTRUDING * s.extruding[kept] + BREAK * ~joined,
    }
    data = b"".join(_steps(np.asarray(columns[name]).astype(form)) for name, form, _ in COLUMNS)
    return {
        "label": method.label,
        "short": nick(method),
        "count": len(kept),
        "byLayer": [rms_um(layers.get(n)) for n in numbers],
        "byFeature": [rms_um(features.get(name)) for name in comparison.features],
        "data": _deflated(data),
    }


def _steps(column: NDArray[Any]) -> bytes:
    """Return differences from point to point, which may wrap, byte plane after byte plane."""
    whole = column.reshape(len(column), -1)
    steps = np.diff(whole, axis=0, prepend=np.zeros_like(whole[:1]))
    planes = np.ascontiguousarray(steps.T).view(np.uint8).reshape(whole.shape[1], len(whole), -1)
    return planes.transpose(0, 2, 1).tobytes()


def log_share(error_um: FloatArray, highest_um: float) -> FloatArray:
    """Scale errors logarithmically: 0 at LOWEST_UM and below, 1 at highest_um."""
    share = np.log(np.maximum(error_um, LOWEST_UM) / LOWEST_UM) / np.log(highest_um / LOWEST_UM)
    return np.asarray(np.minimum(share, 1.0))


def thin(trace: Trace, limit: int) -> tuple[IntArray, BoolArray]:
    """Return the samples that stay, `limit` of them or a few more, and whether each is joined with the one before."""
    samples = trace.method.samples
    starts = np.array([piece.start for piece in unbroken(samples.due)])
    significance = _significance(np.column_stack([trace.foot, ERROR_WEIGHT * trace.away]))
    changes = (np.diff(samples.layer) != 0) | (np.diff(samples.extruding) != 0) | (np.diff(samples.feature) != 0)
    significance[np.flatnonzero(changes) + 1] = np.inf
    significance[starts] = significance[starts - 1] = np.inf  # ends of pieces; before the first is the very last
    kept = np.arange(len(significance))
    if len(kept) > limit:
        threshold = np.partition(significance, -limit)[-limit]
        kept = np.flatnonzero(significance >= max(threshold, FINEST_MM))
    return kept, ~np.isin(kept, starts)


def _significance(points: FloatArray) -> FloatArray:
    """Return how far each point (m, 6) is from the straight line that would replace it; infinite if nothing may.

    A binary hierarchy: level k has every 2^k-th sample. A point's significance is its distance to the middle of its
    two neighbours on the coarsest level that has it, and never less than that of the finer points that lean on it.
    """
    significance = np.full(len(points), np.inf)
    step = 1
    while 2 * step < len(points):
        middle = np.arange(step, len(points) - step, 2 * step)
        bend = np.linalg.norm(points[middle] - (points[middle - step] + points[middle + step]) / 2, axis=1)
        if step > 1:
            bend = np.maximum(bend, np.maximum(significance[middle - step // 2], significance[middle + step // 2]))
        significance[middle] = bend
        step *= 2
    return significance
