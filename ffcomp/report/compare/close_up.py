"""Draw the corners with the largest errors from near: reference, executed motions, error along the path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from ffcomp.comparison.result import Comparison, Method, Samples
from ffcomp.numerics.digits import um
from ffcomp.report.compare.charts import colour_of
from ffcomp.report.compare.words import clipped, nick, shown
from ffcomp.report.drawing import NEIGHBOUR, REFERENCE, grid, plain_decades
from gcode.layers import is_outer_wall
from models.arrays import BoolArray, FloatArray

COUNT = 3  # positions that are shown, if the print is large enough
LEAST_SEPARATION = 0.15  # of the print's width: nearer ones look the same
PASS_WINDOW_S = 0.4  # of the reference plan, before and after the worst instant: other passes are not this one's
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


def worst_positions(comparison: Comparison) -> list[Position]:
    """Find positions, apart from each other, with the largest errors before; on outer walls first."""
    samples = comparison.methods["none"].samples
    return [_position(comparison, int(k)) for k in _worst(samples, _eligible(comparison, samples))]


def _eligible(comparison: Comparison, samples: Samples) -> BoolArray:
    """Return the samples that are seen: of outer walls, or wherever plastic flows, or all."""
    walls = np.array([is_outer_wall(name) for name in comparison.features], dtype=np.bool_)
    seen = samples.extruding & walls[samples.feature]
    if seen.any():
        return seen
    return samples.extruding if samples.extruding.any() else np.ones(len(samples.due), dtype=np.bool_)


def _worst(samples: Samples, eligible: BoolArray) -> Iterator[int]:
    xy = samples.reference[:, :2]
    apart = LEAST_SEPARATION * float(np.ptp(xy[eligible], axis=0).max())
    left = np.where(eligible, samples.contour, -1.0)
    for _ in range(COUNT):
        k = int(np.argmax(left))
        if left[k] < 0.0:
            return
        yield k
        left[np.hypot(*(xy - xy[k]).T) <= apart] = -1.0


def _position(comparison: Comparison, k: int) -> Position:
    samples = comparison.methods["none"].samples
    half = float(np.clip(WIDTH_IN_ERRORS * samples.contour[k], CLOSEST_MM, WIDEST_MM))
    corner = _corner(samples, k, half)
    at, due, layer = samples.reference[corner], float(samples.due[corner]), int(samples.layer[k])
    return Position(
        at=at,
        layer=layer,
        feature=comparison.features[int(samples.feature[k])],
        half_mm=half,
        passes=[_pass(method, at, due, half) for method in shown(comparison)],
        neighbours=_neighbours(samples, at, layer, due, half),
    )


def _corner(samples: Samples, k: int, half: float) -> int:
    """Return the sharpest turn just before the worst sample, which is usually a little behind its corner."""
    back = np.flatnonzero(np.abs(samples.due[: k + 1] - samples.due[k]) < PASS_WINDOW_S)
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
    inside = np.flatnonzero((np.abs(s.due - due) < PASS_WINDOW_S) & _within(s.reference, at, 1.5 * half))
    inside = _unbroken(inside, s.due, due)
    reference = s.reference[inside]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(reference, axis=0), axis=1))])[: len(reference)]
    origin = along[np.argmin(np.linalg.norm(reference - at, axis=1))] if len(along) else 0.0
    return Pass(method, reference, s.nozzle[inside], 1e3 * s.contour[inside], along - origin)


def _unbroken(inside: NDArray[np.int64], due_of: FloatArray, due: float) -> NDArray[np.int64]:
    if not inside.size:
        return inside
    runs = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    return min(runs, key=lambda run: float(np.abs(due_of[run] - due).min()))


def _within(points: FloatArray, at: FloatArray, half: float) -> BoolArray:
    away = np.abs(points - at)
    return (away[:, 2] < SAME_LAYER_MM) & (away[:, :2].max(axis=1) < half)


def _neighbours(samples: Samples, at: FloatArray, layer: int, due: float, half: float) -> list[FloatArray]:
    other = (samples.layer == layer) & (np.abs(samples.due - due) >= PASS_WINDOW_S) & samples.extruding
    inside = np.flatnonzero(other & _within(samples.reference, at, 1.5 * half))
    runs = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    return [samples.reference[run, :2] for run in runs if len(run) > 1]


LEAST_UM = 0.1  # below it the error along the way is not drawn


def draw_places(box: Figure | SubFigure, comparison: Comparison, positions: list[Position]) -> None:
    """Draw the positions side by side, each with its error along the path underneath."""
    columns = np.atleast_2d(box.subplots(2, len(positions), height_ratios=(2.3, 1), squeeze=False))
    for number, position in enumerate(positions):
        _from_above(columns[0, number], comparison, position)
        _along_path(columns[1, number], comparison, position)


def _from_above(axes: Axes, comparison: Comparison, position: Position) -> None:
    x, y, z = position.at
    for line in position.neighbours:
        axes.plot(*line.T, color=NEIGHBOUR, linewidth=1.2, zorder=1)
    for each in position.passes:
        colour, above = colour_of(comparison, each.method), 4 if each.method.name == comparison.compensated else 3
        axes.plot(*each.nozzle[:, :2].T, color=colour, linewidth=1.8, label=_label(each), zorder=above)
    reference = position.passes[0].reference[:, :2].T
    axes.plot(*reference, color=REFERENCE, linewidth=0.9, linestyle=(0, (5, 2)), label="reference", zorder=5)
    _arrow(axes, position)
    _scale_bar(axes, position)
    half = position.half_mm
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal", xticks=[], yticks=[])
    axes.set_title(
        f"X {x:.1f}  Y {y:.1f}  Z {z:.2f} mm\nlayer {position.layer}, {clipped(position.feature)}", parse_math=False
    )
    look: dict[str, Any] = {"frameon": False, "fontsize": 8, "handlelength": 1.4, "columnspacing": 1.2}
    title = {"title": "largest error here", "title_fontsize": 8}
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=2, **look, **title)


def _label(each: Pass) -> str:
    worst = float(each.contour_um.max(initial=0.0))
    return f"{clipped(nick(each.method), 20)}: {um(worst)} µm"


def _arrow(axes: Axes, position: Position) -> None:
    each = position.passes[0]
    k = int(np.argmin(np.abs(each.along_mm + 0.62 * position.half_mm)))
    step = each.reference[min(k + 1, len(each.reference) - 1), :2] - each.reference[k, :2]
    if (length := float(np.hypot(*step))) > 0.0:
        tail, look = each.reference[k], {"arrowstyle": "-|>", "color": REFERENCE, "lw": 0.9, "mutation_scale": 11}
        tip = tail[:2] + 0.12 * position.half_mm * step / length
        axes.annotate("", (tip[0], tip[1]), (tail[0], tail[1]), zorder=6, arrowprops=look)


def _scale_bar(axes: Axes, position: Position) -> None:
    half = position.half_mm
    length = max((n for n in (0.02, 0.05, 0.1, 0.2, 0.5) if n <= 0.4 * half), default=0.02)
    x, y = position.at[0] - 0.92 * half, position.at[1] - 0.92 * half
    axes.plot([x, x + length], [y, y], color=REFERENCE, linewidth=3, solid_capstyle="butt", zorder=7)
    axes.text(
        x + length / 2,
        y + 0.05 * half,
        f"{1e3 * length:g} µm",
        ha="center",
        fontsize=8,
        zorder=7,
        bbox={"facecolor": "#ffffffd0", "edgecolor": "none", "pad": 1},
    )


def _along_path(axes: Axes, comparison: Comparison, position: Position) -> None:
    for each in position.passes:
        axes.semilogy(
            each.along_mm, np.maximum(each.contour_um, LEAST_UM), color=colour_of(comparison, each.method), lw=1.3
        )
    axes.axvline(0.0, color=REFERENCE, linewidth=0.8, linestyle=":")
    axes.set(xlabel="mm along the path from the corner", ylabel="off the path, µm", ylim=(LEAST_UM, None))
    axes.set_xlim(-1.2 * position.half_mm, 1.5 * position.half_mm)
    plain_decades(axes.yaxis)
    grid(axes)
