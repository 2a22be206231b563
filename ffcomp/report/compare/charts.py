"""Draw the figures of a comparison: a row for each method, and lines over layers, features, frequencies and the bed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import distance_transform_edt

from ffcomp.comparison.result import Comparison, EqualQuality, Family, Method, Spread
from ffcomp.numerics.digits import um
from ffcomp.report.compare.samples import HIGHEST_HZ, resonance_band, spectrum
from ffcomp.report.compare.words import (
    FAMILY_NAMES,
    clipped,
    duration,
    feature_errors,
    file_name,
    layer_errors,
    seen,
    shown,
    where_seen,
)
from ffcomp.report.drawing import (
    AFTER,
    BAND,
    BEFORE,
    BEYOND,
    CALIBRATED,
    INK,
    LINE,
    REFERENCE,
    SHAPER,
    SOFT,
    Box,
    grid,
    plain_decades,
)
from models.arrays import FloatArray

NONE, BEST, COMPENSATED = BEFORE, SHAPER, AFTER
FAMILIES: dict[Family, str] = {
    "none": NONE,
    "calibrated": CALIBRATED,
    "best fixed": BEST,
    "inversion": COMPENSATED,
}


def colour_of(comparison: Comparison, method: Method) -> str:
    """Return the colour of one of the three methods that figures show."""
    return {comparison.compensated: COMPENSATED, comparison.best_fixed: BEST}.get(method.name, NONE)


def comparison_band(box: SubFigure, title: str, finding: str, comparison: Comparison) -> None:
    """Draw title, finding, print, machine and program."""
    box.add_artist(Rectangle((0, 0), 1, 1, color=BAND, transform=box.transSubfigure, zorder=-1))
    of = f"{file_name(comparison)}  ·  {comparison.machine.name}, machine file sha256 {comparison.machine.sha256[:12]}"
    by = f"evaluated on {comparison.plant.name}  ·  ffcomp {comparison.version}"
    rows = ((0.74, title, 14, "bold", "#ffffff"), (0.44, finding, 10, "normal", "#ffd08a"))
    for y, text, size, weight, colour in (*rows, (0.17, f"{of}  ·  {by}", 8, "normal", "#b9c2cf")):
        box.text(0.015, y, text, fontsize=size, weight=weight, color=colour, va="center", parse_math=False, wrap=True)


FLOOR_UM = 1e-3  # zeros have no position on a logarithmic axis

Panel = Callable[[Axes, Comparison], None]


def legend(box: Box, handles: Sequence[Artist]) -> None:
    """Explain colours and marks under the figure, as many beside each other as its width has room for."""
    width = box.figure.get_figwidth() if box.figure is not None else 10.0
    columns = max(1, int(width / 2.1))
    box.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, fontsize=8)


def families(comparison: Comparison, *also: Artist) -> list[Artist]:
    """Return what the colours of the bars mean, and other marks."""
    there = dict.fromkeys(method.family for method in comparison.methods.values())
    return [Patch(color=FAMILIES[family], label=FAMILY_NAMES[family]) for family in there] + list(also)


def _mark(sign: str, text: str, **look: Any) -> Line2D:
    return Line2D([], [], linestyle="", marker=sign, color=SOFT, label=text, **look)


def beside(left: Panel, right: Panel) -> Callable[[Box, Comparison], None]:
    """Return how to draw two panels beside each other, the methods' names once."""

    def draw(box: Box, comparison: Comparison) -> None:
        first, second = box.subplots(1, 2)
        left(first, comparison)
        right(second, comparison)
        second.tick_params(axis="y", labelleft=False)
        legend(box, LEGENDS[left](comparison))

    return draw


def alone(panel: Panel) -> Callable[[Box, Comparison], None]:
    """Return how to draw one panel."""

    def draw(box: Box, comparison: Comparison) -> None:
        panel(box.subplots(), comparison)
        legend(box, LEGENDS[panel](comparison))

    return draw


# ---- what the carriages are asked for ------------------------------------------------------------


def velocities(axes: Axes, comparison: Comparison) -> None:
    """Draw the fastest carriage of each method."""
    limit = comparison.limits.get("carriage_velocity_mm_per_s")
    _bars(axes, comparison, lambda m: m.peaks.velocity_mm_per_s, limit)
    axes.set(xlabel="mm/s", title="Fastest carriage")


def accelerations(axes: Axes, comparison: Comparison) -> None:
    """Draw the largest acceleration of a carriage."""
    limit = comparison.limits.get("carriage_acceleration_mm_per_s2")
    _bars(axes, comparison, lambda m: m.peaks.acceleration_mm_per_s2, limit)
    axes.set(xlabel="mm/s²  (1000 mm/s² = 1 m/s²)", title="Largest carriage acceleration")


def _bars(axes: Axes, comparison: Comparison, value: Callable[[Method], float], limit: float | None) -> None:
    methods = list(comparison.methods.values())
    values = [value(method) for method in methods]
    over = [limit is not None and v > 1.001 * limit for v in values]
    colours = [BEYOND if o else FAMILIES[m.family] for o, m in zip(over, methods, strict=True)]
    axes.barh(range(len(methods)), values, color=colours, height=0.7)
    for k, (v, o) in enumerate(zip(values, over, strict=True)):
        axes.text(v, k, f" {v:,.0f}{' ✗' if o else ''}", va="center", fontsize=8, color=BEYOND if o else INK)
    if limit is not None:
        axes.axvline(limit, color=BEYOND, linewidth=1.5)
        axes.text(limit, -0.65, f"limit {limit:,g} ", color=BEYOND, ha="right", va="bottom", fontsize=8)
    _sideways(axes, comparison, methods, 1.2 * max(*values, limit or 0.0))
    axes.set_ylim(len(methods) - 0.4, -1.6)


def _sideways(axes: Axes, comparison: Comparison, methods: Sequence[Method], most: float) -> None:
    axes.set_xlim(0, most or 1.0)
    axes.tick_params(axis="y", length=0)
    axes.locator_params(axis="x", nbins=4)
    grid(axes, "x")
    _rows(axes, comparison, methods)


def _rows(axes: Axes, comparison: Comparison, methods: Sequence[Method]) -> None:
    axes.set_yticks(range(len(methods)), [clipped(method.label) for method in methods], parse_math=False)
    for label, method in zip(axes.get_yticklabels(), methods, strict=True):
        label.set_fontweight("bold" if method.name in (comparison.compensated, comparison.best_fixed) else "normal")
    axes.set_ylim(len(methods) - 0.4, -0.6)


# ---- errors --------------------------------------------------------------------------------------


def errors(axes: Axes, comparison: Comparison) -> None:
    """Draw rms, 99th percentile and maximum of every method on one logarithmic line."""
    methods = list(comparison.methods.values())
    for k, method in enumerate(methods):
        t, colour = seen(comparison, method), FAMILIES[method.family]
        numbers = np.maximum([t.contour_rms_um, t.contour_p99_um, t.contour_max_um], FLOOR_UM)
        axes.semilogx(numbers[[0, 2]], [k, k], color=colour, linewidth=1.5)
        axes.semilogx(numbers[0], k, "o", color=colour, markersize=8)
        axes.semilogx(numbers[1], k, "|", color=colour, markersize=11, markeredgewidth=2)
        axes.semilogx(numbers[2], k, ".", color=colour, markersize=6)
        axes.text(0.9 * numbers[0], k, f"{um(t.contour_rms_um)}  ", ha="right", va="center", fontsize=8)
    axes.set_xlabel(f"contour error {where_seen(comparison)}, µm")
    axes.margins(x=0.25)  # room for the number beside the leftmost dot
    _logarithmic(axes, comparison, methods)


def _logarithmic(axes: Axes, comparison: Comparison, methods: Sequence[Method]) -> None:
    _rows(axes, comparison, methods)
    plain_decades(axes.xaxis)
    grid(axes, "x")


def _error_marks(comparison: Comparison) -> list[Artist]:
    return families(comparison, _mark("o", "rms"), _mark("|", "99 % below"), _mark(".", "largest"))


def mismatches(axes: Axes, comparison: Comparison) -> None:
    """Draw every Monte-Carlo plant as a dot; the bar is their median, the ring the nominal plant."""
    methods = [method for method in comparison.methods.values() if method.spread is not None]
    for k, method in enumerate(methods):
        assert method.spread is not None
        colour = FAMILIES[method.family]
        _dots(axes, k, method.spread, "o", color=colour, alpha=0.6, markeredgewidth=0)
        axes.semilogx(method.spread.median_um, k, "|", color=colour, markersize=18, markeredgewidth=2.5)
        axes.semilogx(method.track.contour_rms_um, k, "o", color=colour, markersize=8, markerfacecolor="none", mew=1.5)
        if method.retuned is not None:
            _dots(axes, k, method.retuned, "+", color=INK)
    axes.set_xlabel("contour error, all moves, µm rms")
    _logarithmic(axes, comparison, methods)


def _dots(axes: Axes, row: int, spread: Spread, marker: str, **look: Any) -> None:
    """Draw one dot a Monte-Carlo plant, spread over the row's height."""
    values = np.maximum(spread.contour_rms_um, FLOOR_UM)
    axes.semilogx(values, row + 0.25 * np.sin(2.4 * np.arange(len(values))), marker, markersize=4, **look)


def _mismatch_marks(comparison: Comparison) -> list[Artist]:
    ring = _mark("o", "the printer itself", markerfacecolor="none")
    marks = _mark(".", "Monte-Carlo plants"), _mark("|", "their median"), ring, _mark("+", "tuned again on each")
    return families(comparison, *marks)


# ---- equal quality -------------------------------------------------------------------------------


def fastest(axes: Axes, comparison: Comparison) -> None:
    """Draw how hard each method may accelerate."""
    _qualities(axes, comparison, lambda quality: quality.acceleration_mm_per_s2, _highest)
    axes.set(xlabel="mm/s²  (1000 mm/s² = 1 m/s²)", title=f"{comparison.quality_bound_um:g} µm up to")


def print_times(axes: Axes, comparison: Comparison) -> None:
    """Draw how long the whole print takes then."""
    times = [m.equal_quality.print_time_s for m in comparison.methods.values() if m.equal_quality is not None]
    unit_s, unit = (1, "seconds") if max(times, default=0.0) < 120 else (60, "minutes")
    _qualities(axes, comparison, lambda quality: quality.print_time_s / unit_s, lambda q: duration(q.print_time_s))
    axes.set(xlabel=unit, title="The whole print then takes")


def _highest(quality: EqualQuality) -> str:
    sign = "≥ " if quality.capped else "" if quality.reached else "< "
    return f"{sign}{quality.acceleration_mm_per_s2:,.0f}"


def _qualities(
    axes: Axes, comparison: Comparison, value: Callable[[EqualQuality], float], text: Callable[[EqualQuality], str]
) -> None:
    evaluated = [(m, m.equal_quality) for m in comparison.methods.values() if m.equal_quality is not None]
    for k, (method, quality) in enumerate(evaluated):
        look: dict[str, Any] = {"color": FAMILIES[method.family]} if quality.reached else {"fill": False}
        axes.barh(k, value(quality), edgecolor=FAMILIES[method.family], height=0.7, **look)
        axes.text(value(quality), k, f" {text(quality)}", va="center", fontsize=8)
    most = max((value(quality) for _, quality in evaluated), default=1.0)
    _sideways(axes, comparison, [method for method, _ in evaluated], 1.35 * most)


def _quality_marks(comparison: Comparison) -> list[Artist]:
    missed = Patch(fill=False, edgecolor=SOFT, label="empty: missed even there")
    return families(comparison, missed)


def _limit_marks(comparison: Comparison) -> list[Artist]:
    return families(comparison, Patch(color=BEYOND, label="✗ beyond the limit"))


LEGENDS: dict[Panel, Callable[[Comparison], list[Artist]]] = {
    velocities: _limit_marks,
    accelerations: _limit_marks,
    errors: _error_marks,
    mismatches: _mismatch_marks,
    fastest: _quality_marks,
    print_times: _quality_marks,
}


MAP_GRAINS = 120  # dots across the bed map that say where the print was


# ---- by layer, by feature ------------------------------------------------------------------------


def draw_layers(box: Box, comparison: Comparison) -> None:
    """Draw the error by layer and by feature."""
    left, right = box.subplots(1, 2, width_ratios=(1.5, 1))
    by_layer(left, comparison)
    by_feature(right, comparison)
    method_legend(box, comparison)


def method_legend(box: Box, comparison: Comparison) -> None:
    """Name the methods that lines and dots belong to."""
    handles = [
        Line2D([], [], color=colour_of(comparison, method), marker="o", markersize=4, label=clipped(method.label))
        for method in shown(comparison)
    ]
    legend(box, handles)


def by_layer(axes: Axes, comparison: Comparison) -> None:
    """Draw a line a method over the layers."""
    for method in shown(comparison):
        layers = layer_errors(comparison, method)
        numbers = sorted(layers)
        values = [max(layers[n].rms_um, FLOOR_UM) for n in numbers]
        axes.semilogy(numbers, values, "o-", color=colour_of(comparison, method), markersize=3, linewidth=1.2)
    axes.set(xlabel="layer", ylabel="contour error, µm rms", title="By layer")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    plain_decades(axes.yaxis)
    grid(axes)


def by_feature(axes: Axes, comparison: Comparison) -> None:
    """Draw a line a feature, the most frequent one on top."""
    none = feature_errors(comparison, comparison.methods["none"])
    names = sorted(none, key=lambda name: none[name].share)
    for method in shown(comparison):
        errors = feature_errors(comparison, method)
        rows = [(k, errors[name].rms_um) for k, name in enumerate(names) if name in errors]
        values = [max(value, FLOOR_UM) for _, value in rows]
        axes.semilogx(values, [k for k, _ in rows], "o", color=colour_of(comparison, method), markersize=6)
    labels = [f"{clipped(name)}  {none[name].share:.0%}" for name in names]
    axes.set_yticks(range(len(names)), labels, parse_math=False)
    axes.set(xlabel="contour error, µm rms", title="By feature (share of the time)", ylim=(-0.6, len(names) - 0.4))
    plain_decades(axes.xaxis)
    grid(axes)


# ---- spectrum ------------------------------------------------------------------------------------


def draw_spectrum(box: Box, comparison: Comparison) -> None:
    """Draw the spectrum of the contour error."""
    spectra(box.subplots(), comparison)


def spectra(axes: Axes, comparison: Comparison) -> None:
    """Draw a line a method over the frequencies, and shade those that the printer rings at."""
    if (mode := resonance_band(comparison)) is not None:
        axes.axvspan(*mode, color=LINE, zorder=0, label=f"resonance where it printed: {mode[0]:.0f}–{mode[1]:.0f} Hz")
    low, top = np.inf, 0.0
    for method in shown(comparison):
        if (each := spectrum(method, comparison.sample_s)) is not None:
            amplitude = np.sqrt(each.density_um2_per_hz)
            low, top = min(low, float(amplitude[1:].min())), max(top, float(amplitude.max()))
            line = np.maximum(amplitude, FLOOR_UM)
            axes.semilogy(
                each.frequency_hz, line, color=colour_of(comparison, method), lw=1.5, label=clipped(method.label)
            )
    if top == 0.0:
        axes.text(0.5, 0.5, "The evaluated part is too short for a spectrum.", ha="center", transform=axes.transAxes)
        return
    axes.set(
        xlabel="frequency, Hz",
        ylabel="contour error, µm/√Hz",
        xlim=(0, HIGHEST_HZ),
        ylim=(max(low, top / 1e5) / 2, 2 * top),
    )
    plain_decades(axes.yaxis)
    grid(axes)
    axes.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))


# ---- bed map -------------------------------------------------------------------------------------


def draw_bed(box: Box, comparison: Comparison) -> None:
    """Draw the resonances over the bed."""
    for axes, along in zip(box.subplots(1, 2, sharey=True), (0, 1), strict=True):
        bed_map(axes, comparison, along)


def bed_map(axes: Axes, comparison: Comparison, along: int) -> None:
    """Draw the resonance along X (0) or Y (1), in greys that mean nothing else, and where the print stood."""
    assert comparison.bed is not None
    bed = comparison.bed
    grain = float(np.ptp(bed.x_mm)) / MAP_GRAINS
    path = grain * np.unique(np.round(comparison.methods["none"].samples.reference[:, :2] / grain), axis=0)
    values = _to_the_rim(bed.frequency_hz[:, :, along])
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    levels = np.linspace(low, max(high, 1.02 * low), 9)
    areas = axes.contourf(bed.x_mm, bed.y_mm, values, levels=levels, cmap="Greys", alpha=0.55)
    lines = axes.contour(bed.x_mm, bed.y_mm, values, levels=levels[1:-1:2], colors=SOFT, linewidths=0.7)
    rim = Circle((0, 0), float(bed.x_mm[-1]), transform=axes.transData)
    for drawn in (areas, lines):
        drawn.set_clip_path(rim)
    axes.clabel(lines, fmt="%.0f Hz", fontsize=8, colors=INK)
    axes.plot(*path.T, ".", color=REFERENCE, markersize=1.6, markeredgewidth=0)
    axes.set(aspect="equal", xlabel="X, mm", ylabel="Y, mm", title=f"Resonance along {'XY'[along]}, Hz")
    for side in axes.spines.values():
        side.set_visible(False)


def _to_the_rim(values: FloatArray) -> FloatArray:
    """Extend the map by the nearest known value, so that the bed's edge comes out round."""
    nearest = distance_transform_edt(np.isnan(values), return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])
