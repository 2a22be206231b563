"""Find the positions with the largest errors, and the pass of each method's nozzle there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.compare.result import Comparison, Method, Samples
from ffcomp.report.compare.words import shown
from gcode.layers import is_outer_wall
from models.arrays import BoolArray, FloatArray

COUNT = 3  # positions that are shown, if the print is large enough
APART = 0.15  # of the print's width: nearer ones look the same
AROUND_S = 0.4  # of the reference plan, before and after the worst instant: other passes are not this one's
CLOSEST_MM, WIDEST_MM = 0.4, 2.5  # half the width of the window
WIDTH_IN_ERRORS = 8.0  # half the width, in largest errors
SAME_LAYER_MM = 0.05


@dataclass(frozen=True, eq=False)
class Pass:
    """k samples of one method, on its way through the window."""

    method: Method
    reference: FloatArray  # (k, 3) mm
    nozzle: FloatArray  # (k, 3) mm
    contour_um: FloatArray  # (k,)
    along_mm: FloatArray  # (k,) of the reference path, from the corner


@dataclass(frozen=True, eq=False)
class Position:
    """A corner and its surroundings."""

    at: FloatArray  # (3,) mm, the corner of the reference path
    layer: int
    feature: str
    half_mm: float  # half the width of the window
    passes: list[Pass]  # as `shown`
    neighbours: list[FloatArray]  # (k, 2) mm each, other lines of the layer


def worst_positions(found: Comparison, count: int = COUNT) -> list[Position]:
    """Find positions, apart from each other, with the largest errors before; on outer walls first."""
    samples = found.methods["none"].samples
    return [_position(found, int(k)) for k in _worst(samples, _eligible(found, samples), count)]


def _eligible(found: Comparison, samples: Samples) -> BoolArray:
    """Return the samples that are seen: of outer walls, or wherever plastic flows, or all."""
    walls = np.array([is_outer_wall(name) for name in found.features], dtype=np.bool_)
    seen = samples.extruding & walls[samples.feature]
    if seen.any():
        return seen
    return samples.extruding if samples.extruding.any() else np.ones(len(samples.due), dtype=np.bool_)


def _worst(samples: Samples, eligible: BoolArray, count: int) -> Iterator[int]:
    xy = samples.reference[:, :2]
    apart = APART * float(np.ptp(xy[eligible], axis=0).max())
    left = np.where(eligible, samples.contour, -1.0)
    for _ in range(count):
        k = int(np.argmax(left))
        if left[k] < 0.0:
            return
        yield k
        left[np.hypot(*(xy - xy[k]).T) <= apart] = -1.0


def _position(found: Comparison, k: int) -> Position:
    samples = found.methods["none"].samples
    half = float(np.clip(WIDTH_IN_ERRORS * samples.contour[k], CLOSEST_MM, WIDEST_MM))
    corner = _corner(samples, k, half)
    at, due, layer = samples.reference[corner], float(samples.due[corner]), int(samples.layer[k])
    return Position(
        at=at,
        layer=layer,
        feature=found.features[int(samples.feature[k])],
        half_mm=half,
        passes=[_pass(method, at, due, half) for method in shown(found)],
        neighbours=_neighbours(samples, at, layer, due, half),
    )


def _corner(samples: Samples, k: int, half: float) -> int:
    """Return the sharpest turn just before the worst sample, which is usually a little behind its corner."""
    back = np.flatnonzero(np.abs(samples.due[: k + 1] - samples.due[k]) < AROUND_S)
    back = back[np.abs(samples.reference[back] - samples.reference[k]).max(axis=1) < 0.8 * half]
    steps = np.diff(samples.reference[max(back[0] - 1, 0) : back[-1] + 2, :2], axis=0)
    length = np.linalg.norm(steps, axis=1)
    moving = length > 1e-6
    cosine = np.einsum("ij,ij->i", steps[1:], steps[:-1]) / np.maximum(length[1:] * length[:-1], 1e-12)
    turn = np.where(moving[1:] & moving[:-1], 1.0 - cosine, 0.0)
    if not len(turn) or turn.max() < 0.05:
        return k
    return max(int(back[0]) - 1, 0) + 1 + int(np.argmax(turn))


def _pass(method: Method, at: FloatArray, due: float, half: float) -> Pass:
    s = method.samples
    inside = np.flatnonzero((np.abs(s.due - due) < AROUND_S) & _within(s.reference, at, 1.5 * half))
    inside = _unbroken(inside, s.due, due)
    reference = s.reference[inside]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(reference, axis=0), axis=1))])[: len(reference)]
    origin = along[np.argmin(np.linalg.norm(reference - at, axis=1))] if len(along) else 0.0
    return Pass(method, reference, s.nozzle[inside], 1e3 * s.contour[inside], along - origin)


def _unbroken(inside: NDArray[np.int64], due_of: FloatArray, due: float) -> NDArray[np.int64]:
    """Return the neighbouring samples around the instant `due`."""
    if not inside.size:
        return inside
    runs = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    return min(runs, key=lambda run: float(np.abs(due_of[run] - due).min()))


def _within(points: FloatArray, at: FloatArray, half: float) -> BoolArray:
    away = np.abs(points - at)
    return (away[:, 2] < SAME_LAYER_MM) & (away[:, :2].max(axis=1) < half)


def _neighbours(samples: Samples, at: FloatArray, layer: int, due: float, half: float) -> list[FloatArray]:
    """Return the other extruding lines of this layer."""
    other = (samples.layer == layer) & (np.abs(samples.due - due) >= AROUND_S) & samples.extruding
    inside = np.flatnonzero(other & _within(samples.reference, at, 1.5 * half))
    runs = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    return [samples.reference[run, :2] for run in runs if len(run) > 1]
