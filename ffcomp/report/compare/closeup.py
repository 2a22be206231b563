"""Draw a corner from near: the reference, the executed motions, and their error along the path."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from ffcomp.compare.result import Comparison
from ffcomp.report.compare.positions import Pass, Position
from ffcomp.report.compare.style import colour_of
from ffcomp.report.compare.words import clipped, nick, um
from ffcomp.report.shared.style import NEIGHBOUR, REFERENCE, grid, plain_decades

LEAST_UM = 0.1  # below it the error along the way is not drawn


def draw_places(box: Figure | SubFigure, found: Comparison, positions: list[Position]) -> None:
    """Draw the positions side by side, each with its error along the path underneath."""
    columns = np.atleast_2d(box.subplots(2, len(positions), height_ratios=(2.3, 1), squeeze=False))
    for number, position in enumerate(positions):
        _seen(columns[0, number], found, position)
        _along(columns[1, number], found, position)


def _seen(axes: Axes, found: Comparison, position: Position) -> None:
    x, y, z = position.at
    for line in position.neighbours:
        axes.plot(*line.T, color=NEIGHBOUR, linewidth=1.2, zorder=1)
    for each in position.passes:
        colour, above = colour_of(found, each.method), 4 if each.method.name == found.compensated else 3
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
    """Mark the direction of motion on the reference path."""
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


def _along(axes: Axes, found: Comparison, position: Position) -> None:
    for each in position.passes:
        axes.semilogy(each.along_mm, np.maximum(each.contour_um, LEAST_UM), color=colour_of(found, each.method), lw=1.3)
    axes.axvline(0.0, color=REFERENCE, linewidth=0.8, linestyle=":")
    axes.set(xlabel="mm along the path from the corner", ylabel="off the path, µm", ylim=(LEAST_UM, None))
    axes.set_xlim(-1.2 * position.half_mm, 1.5 * position.half_mm)
    plain_decades(axes.yaxis)
    grid(axes)
