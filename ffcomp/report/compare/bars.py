"""Draw the figures that have a row for each method: limits, errors, mismatch, equal quality."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ffcomp.compare.result import Comparison, EqualQuality, Method, Spread
from ffcomp.report.compare.style import FAMILIES
from ffcomp.report.compare.words import FAMILY_NAMES, clipped, duration, seen, um, where_seen
from ffcomp.report.shared.drawing import Box
from ffcomp.report.shared.style import BEYOND, INK, SOFT, grid, plain_decades

FLOOR_UM = 1e-3  # zeros have no position on a logarithmic axis

Panel = Callable[[Axes, Comparison], None]


def legend(box: Box, handles: Sequence[Artist]) -> None:
    """Explain colours and marks under the figure, as many beside each other as its width has room for."""
    width = box.figure.get_figwidth() if box.figure is not None else 10.0
    columns = max(1, int(width / 2.1))
    box.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, fontsize=8)


def families(found: Comparison, *also: Artist) -> list[Artist]:
    """Return what the colours of the bars mean, and other marks."""
    there = dict.fromkeys(method.family for method in found.methods.values())
    return [Patch(color=FAMILIES[family], label=FAMILY_NAMES[family]) for family in there] + list(also)


def _mark(sign: str, text: str, **look: Any) -> Line2D:
    return Line2D([], [], linestyle="", marker=sign, color=SOFT, label=text, **look)


def beside(left: Panel, right: Panel) -> Callable[[Box, Comparison], None]:
    """Return how to draw two panels beside each other, the methods' names once."""

    def draw(box: Box, found: Comparison) -> None:
        first, second = box.subplots(1, 2)
        left(first, found)
        right(second, found)
        second.tick_params(axis="y", labelleft=False)
        legend(box, LEGENDS[left](found))

    return draw


def alone(panel: Panel) -> Callable[[Box, Comparison], None]:
    """Return how to draw one panel."""

    def draw(box: Box, found: Comparison) -> None:
        panel(box.subplots(), found)
        legend(box, LEGENDS[panel](found))

    return draw


# ---- what the carriages are asked for ------------------------------------------------------------


def velocities(axes: Axes, found: Comparison) -> None:
    """Draw the fastest carriage of each method."""
    limit = found.limits.get("carriage_velocity_mm_per_s")
    _bars(axes, found, lambda m: m.peaks.velocity_mm_per_s, limit)
    axes.set(xlabel="mm/s", title="Fastest carriage")


def accelerations(axes: Axes, found: Comparison) -> None:
    """Draw the largest acceleration of a carriage."""
    limit = found.limits.get("carriage_acceleration_mm_per_s2")
    _bars(axes, found, lambda m: m.peaks.acceleration_mm_per_s2, limit)
    axes.set(xlabel="mm/s²  (1000 mm/s² = 1 m/s²)", title="Largest carriage acceleration")


def _bars(axes: Axes, found: Comparison, value: Callable[[Method], float], limit: float | None) -> None:
    methods = list(found.methods.values())
    values = [value(method) for method in methods]
    over = [limit is not None and v > 1.001 * limit for v in values]
    colours = [BEYOND if o else FAMILIES[m.family] for o, m in zip(over, methods, strict=True)]
    axes.barh(range(len(methods)), values, color=colours, height=0.7)
    for k, (v, o) in enumerate(zip(values, over, strict=True)):
        axes.text(v, k, f" {v:,.0f}{' ✗' if o else ''}", va="center", fontsize=8, color=BEYOND if o else INK)
    if limit is not None:
        axes.axvline(limit, color=BEYOND, linewidth=1.5)
        axes.text(limit, -0.65, f"limit {limit:,g} ", color=BEYOND, ha="right", va="bottom", fontsize=8)
    _sideways(axes, found, methods, 1.2 * max(*values, limit or 0.0))
    axes.set_ylim(len(methods) - 0.4, -1.6)


def _sideways(axes: Axes, found: Comparison, methods: Sequence[Method], most: float) -> None:
    axes.set_xlim(0, most or 1.0)
    axes.tick_params(axis="y", length=0)
    axes.locator_params(axis="x", nbins=4)
    grid(axes, "x")
    _rows(axes, found, methods)


def _rows(axes: Axes, found: Comparison, methods: Sequence[Method]) -> None:
    axes.set_yticks(range(len(methods)), [clipped(method.label) for method in methods], parse_math=False)
    for label, method in zip(axes.get_yticklabels(), methods, strict=True):
        label.set_fontweight("bold" if method.name in (found.compensated, found.best_fixed) else "normal")
    axes.set_ylim(len(methods) - 0.4, -0.6)


# ---- errors --------------------------------------------------------------------------------------


def errors(axes: Axes, found: Comparison) -> None:
    """Draw rms, 99th percentile and maximum of every method on one logarithmic line."""
    methods = list(found.methods.values())
    for k, method in enumerate(methods):
        t, colour = seen(found, method), FAMILIES[method.family]
        numbers = np.maximum([t.contour_rms_um, t.contour_p99_um, t.contour_max_um], FLOOR_UM)
        axes.semilogx(numbers[[0, 2]], [k, k], color=colour, linewidth=1.5)
        axes.semilogx(numbers[0], k, "o", color=colour, markersize=8)
        axes.semilogx(numbers[1], k, "|", color=colour, markersize=11, markeredgewidth=2)
        axes.semilogx(numbers[2], k, ".", color=colour, markersize=6)
        axes.text(0.9 * numbers[0], k, f"{um(t.contour_rms_um)}  ", ha="right", va="center", fontsize=8)
    axes.set_xlabel(f"contour error {where_seen(found)}, µm")
    axes.margins(x=0.25)  # room for the number beside the leftmost dot
    _logarithmic(axes, found, methods)


def _logarithmic(axes: Axes, found: Comparison, methods: Sequence[Method]) -> None:
    _rows(axes, found, methods)
    plain_decades(axes.xaxis)
    grid(axes, "x")


def _error_marks(found: Comparison) -> list[Artist]:
    return families(found, _mark("o", "rms"), _mark("|", "99 % below"), _mark(".", "largest"))


def mismatches(axes: Axes, found: Comparison) -> None:
    """Draw every Monte-Carlo plant as a dot; the bar is their median, the ring the nominal plant."""
    methods = [method for method in found.methods.values() if method.spread is not None]
    for k, method in enumerate(methods):
        assert method.spread is not None
        colour = FAMILIES[method.family]
        _dots(axes, k, method.spread, "o", color=colour, alpha=0.6, markeredgewidth=0)
        axes.semilogx(method.spread.median_um, k, "|", color=colour, markersize=18, markeredgewidth=2.5)
        axes.semilogx(method.track.contour_rms_um, k, "o", color=colour, markersize=8, markerfacecolor="none", mew=1.5)
        if method.retuned is not None:
            _dots(axes, k, method.retuned, "+", color=INK)
    axes.set_xlabel("contour error, all moves, µm rms")
    _logarithmic(axes, found, methods)


def _dots(axes: Axes, row: int, spread: Spread, marker: str, **look: Any) -> None:
    """Draw one dot a Monte-Carlo plant, spread over the row's height."""
    values = np.maximum(spread.contour_rms_um, FLOOR_UM)
    axes.semilogx(values, row + 0.25 * np.sin(2.4 * np.arange(len(values))), marker, markersize=4, **look)


def _mismatch_marks(found: Comparison) -> list[Artist]:
    ring = _mark("o", "the printer itself", markerfacecolor="none")
    marks = _mark(".", "Monte-Carlo plants"), _mark("|", "their median"), ring, _mark("+", "tuned again on each")
    return families(found, *marks)


# ---- equal quality -------------------------------------------------------------------------------


def fastest(axes: Axes, found: Comparison) -> None:
    """Draw how hard each method may accelerate."""
    _qualities(axes, found, lambda quality: quality.acceleration_mm_per_s2, _highest)
    axes.set(xlabel="mm/s²  (1000 mm/s² = 1 m/s²)", title=f"{found.quality_bound_um:g} µm up to")


def print_times(axes: Axes, found: Comparison) -> None:
    """Draw how long the whole print takes then."""
    times = [m.equal_quality.print_time_s for m in found.methods.values() if m.equal_quality is not None]
    unit_s, unit = (1, "seconds") if max(times, default=0.0) < 120 else (60, "minutes")
    _qualities(axes, found, lambda quality: quality.print_time_s / unit_s, lambda q: duration(q.print_time_s))
    axes.set(xlabel=unit, title="The whole print then takes")


def _highest(quality: EqualQuality) -> str:
    sign = "≥ " if quality.capped else "" if quality.reached else "< "
    return f"{sign}{quality.acceleration_mm_per_s2:,.0f}"


def _qualities(
    axes: Axes, found: Comparison, value: Callable[[EqualQuality], float], said: Callable[[EqualQuality], str]
) -> None:
    evaluated = [(m, m.equal_quality) for m in found.methods.values() if m.equal_quality is not None]
    for k, (method, quality) in enumerate(evaluated):
        look: dict[str, Any] = {"color": FAMILIES[method.family]} if quality.reached else {"fill": False}
        axes.barh(k, value(quality), edgecolor=FAMILIES[method.family], height=0.7, **look)
        axes.text(value(quality), k, f" {said(quality)}", va="center", fontsize=8)
    most = max((value(quality) for _, quality in evaluated), default=1.0)
    _sideways(axes, found, [method for method, _ in evaluated], 1.35 * most)


def _quality_marks(found: Comparison) -> list[Artist]:
    missed = Patch(fill=False, edgecolor=SOFT, label="empty: missed even there")
    return families(found, missed)


def _limit_marks(found: Comparison) -> list[Artist]:
    return families(found, Patch(color=BEYOND, label="✗ beyond the limit"))


LEGENDS: dict[Panel, Callable[[Comparison], list[Artist]]] = {
    velocities: _limit_marks,
    accelerations: _limit_marks,
    errors: _error_marks,
    mismatches: _mismatch_marks,
    fastest: _quality_marks,
    print_times: _quality_marks,
}
