"""Draw the figures with axes: by layer and feature, spectrum, bed map, limits, methods, mismatch, equal quality."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import distance_transform_edt

from ffcomp.compare.result import Comparison, Method, Spread
from ffcomp.report.compare.spectrum import HIGHEST_HZ, resonance_band, spectrum
from ffcomp.report.compare.style import FAMILIES, colour_of
from ffcomp.report.compare.words import clipped, duration, shown, um
from ffcomp.report.shared.drawing import Box
from ffcomp.report.shared.style import BAND, INK, grid, plain_decades
from models.arrays import FloatArray

BEYOND = "#b00020"  # more than the machine allows
FLOOR_UM = 1e-3  # zeros have no position on a logarithmic axis
MAP_GRAINS = 120  # dots across the bed map that say where the print was


# ---- by layer, by feature ------------------------------------------------------------------------


def draw_layers(box: Box, found: Comparison) -> None:
    """Draw the error by layer and by feature."""
    left, right = box.subplots(1, 2, width_ratios=(1.5, 1))
    _by_layer(left, found)
    _by_feature(right, found)
    handles = [
        Line2D([], [], color=colour_of(found, method), marker="o", markersize=4, label=clipped(method.label))
        for method in shown(found)
    ]
    box.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)


def _by_layer(axes: Axes, found: Comparison) -> None:
    for method in shown(found):
        numbers = sorted(method.by_layer)
        values = [max(method.by_layer[n].rms_um, FLOOR_UM) for n in numbers]
        axes.semilogy(numbers, values, "o-", color=colour_of(found, method), markersize=3, linewidth=1.2)
    axes.set(xlabel="layer", ylabel="contour error, µm rms", title="By layer")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    plain_decades(axes.yaxis)
    grid(axes)


def _by_feature(axes: Axes, found: Comparison) -> None:
    """Draw a line a feature, the most frequent one on top."""
    none = found.methods["none"].by_feature
    names = sorted(none, key=lambda name: none[name].share)
    for method in shown(found):
        rows = [(k, method.by_feature[name].rms_um) for k, name in enumerate(names) if name in method.by_feature]
        values = [max(value, FLOOR_UM) for _, value in rows]
        axes.semilogx(values, [k for k, _ in rows], "o", color=colour_of(found, method), markersize=6)
    labels = [f"{clipped(name)}  {none[name].share:.0%}" for name in names]
    axes.set_yticks(range(len(names)), labels, parse_math=False)
    axes.set(xlabel="contour error, µm rms", title="By feature (share of the time)", ylim=(-0.6, len(names) - 0.4))
    plain_decades(axes.xaxis)
    grid(axes)


# ---- spectrum ------------------------------------------------------------------------------------


def draw_spectrum(box: Box, found: Comparison) -> None:
    """Draw the spectrum of the contour error."""
    axes = box.subplots()
    if (mode := resonance_band(found)) is not None:
        axes.axvspan(
            *mode, color="#f2e3c6", zorder=0, label=f"resonance where it printed: {mode[0]:.0f}–{mode[1]:.0f} Hz"
        )
    low, top = np.inf, 0.0
    for method in shown(found):
        if (each := spectrum(method, found.sample_s)) is not None:
            amplitude = np.sqrt(each.density_um2_per_hz)
            low, top = min(low, float(amplitude[1:].min())), max(top, float(amplitude.max()))
            label = f"{clipped(method.label)}: {um(method.track.contour_rms_um)} µm rms"
            axes.semilogy(
                each.frequency_hz, np.maximum(amplitude, FLOOR_UM), color=colour_of(found, method), lw=1.5, label=label
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
    axes.legend(frameon=False, loc="upper right")


# ---- bed map -------------------------------------------------------------------------------------


def draw_bed(box: Box, found: Comparison) -> None:
    """Draw the resonances over the bed."""
    assert found.bed is not None
    bed = found.bed
    grain = float(np.ptp(bed.x_mm)) / MAP_GRAINS
    path = grain * np.unique(np.round(found.methods["none"].samples.reference[:, :2] / grain), axis=0)
    low, high = float(np.nanmin(bed.frequency_hz)), float(np.nanmax(bed.frequency_hz))
    levels = np.linspace(low, max(high, 1.02 * low), 21)
    both = box.subplots(1, 2, sharey=True)
    for k, axes in enumerate(both):
        values = _to_the_rim(bed.frequency_hz[:, :, k])
        colours = axes.contourf(bed.x_mm, bed.y_mm, values, levels=levels, cmap="viridis")
        lines = axes.contour(bed.x_mm, bed.y_mm, values, levels=levels[2::4], colors="#ffffffb0", linewidths=0.7)
        axes.clabel(lines, fmt="%.0f Hz", fontsize=7)
        rim = Circle((0, 0), float(bed.x_mm[-1]), transform=axes.transData)
        for drawn in (colours, lines):
            drawn.set_clip_path(rim)
        axes.plot(*path.T, ".", color="#ffffff", markersize=2.0, markeredgewidth=0, rasterized=True)
        axes.set(aspect="equal", xlabel="X, mm", title=f"Resonance along {'XY'[k]}")
        for side in axes.spines.values():
            side.set_visible(False)
    both[0].set_ylabel("Y, mm")
    box.colorbar(colours, ax=list(both), label="frequency, Hz", format="%.0f", shrink=0.8)


def _to_the_rim(values: FloatArray) -> FloatArray:
    """Extend the map by the nearest known value, so that the bed's edge comes out round."""
    nearest = distance_transform_edt(np.isnan(values), return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])


# ---- bars over methods ---------------------------------------------------------------------------


def draw_limits(box: Box, found: Comparison) -> None:
    """Draw the demand on the carriages beside their limits."""
    left, right = box.subplots(1, 2, sharey=True)
    limits = found.limits
    _bars(left, found, lambda m: m.peaks.velocity_mm_per_s, limits.get("carriage_velocity_mm_per_s"))
    limit = limits.get("carriage_acceleration_mm_per_s2")
    _bars(right, found, lambda m: m.peaks.acceleration_mm_per_s2 / 1e3, None if limit is None else limit / 1e3)
    _rows(left, found, list(found.methods.values()))
    left.set(xlabel="mm/s", title="Fastest carriage", ylim=(len(found.methods) - 0.4, -1.0))
    right.set(xlabel="m/s²", title="Largest carriage acceleration")


def _bars(axes: Axes, found: Comparison, value: Callable[[Method], float], limit: float | None) -> None:
    methods = list(found.methods.values())
    values = [value(method) for method in methods]
    over = [limit is not None and v > 1.001 * limit for v in values]
    colours = [BEYOND if o else FAMILIES[m.family] for o, m in zip(over, methods, strict=True)]
    axes.barh(range(len(methods)), values, color=colours, height=0.7)
    for k, (v, o) in enumerate(zip(values, over, strict=True)):
        axes.text(v, k, f" {v:.3g}{' ✗' if o else ''}", va="center", fontsize=8, color=BEYOND if o else INK)
    if limit is not None:
        axes.axvline(limit, color=BEYOND, linewidth=1.5)
        axes.text(limit, -0.75, f"limit {limit:g} ", color=BEYOND, ha="right", va="bottom", fontsize=8)
    axes.set_xlim(0, 1.15 * max(*values, limit or 0.0))
    axes.tick_params(axis="y", length=0)
    grid(axes, "x")


def _rows(axes: Axes, found: Comparison, methods: Sequence[Method]) -> None:
    axes.set_yticks(range(len(methods)), [clipped(method.label) for method in methods], parse_math=False)
    for label, method in zip(axes.get_yticklabels(), methods, strict=True):
        label.set_fontweight("bold" if method.name in (found.compensated, found.best_fixed) else "normal")
    axes.set_ylim(len(methods) - 0.4, -0.6)


def draw_methods(box: Box, found: Comparison) -> None:
    """Draw rms, 99th percentile and maximum of every method on one logarithmic line."""
    axes = box.subplots()
    methods = list(found.methods.values())
    for k, method in enumerate(methods):
        t, colour = method.track, FAMILIES[method.family]
        numbers = np.maximum([t.contour_rms_um, t.contour_p99_um, t.contour_max_um], FLOOR_UM)
        axes.semilogx(numbers[[0, 2]], [k, k], color=colour, linewidth=2, alpha=0.35)
        axes.semilogx(numbers[0], k, "o", color=colour, markersize=9)
        axes.semilogx(numbers[1], k, "|", color=colour, markersize=11, markeredgewidth=2)
        axes.semilogx(numbers[2], k, ".", color=colour, markersize=6)
        axes.text(0.93 * numbers[0], k, f"{um(t.contour_rms_um)}  ", ha="right", va="center")
    axes.set_xlabel("contour error over all moves, µm:  ● rms   | 99 % below   • largest")
    axes.margins(x=0.12)
    _rows(axes, found, methods)
    plain_decades(axes.xaxis)
    grid(axes, "x")


def draw_mismatch(box: Box, found: Comparison) -> None:
    """Draw every Monte-Carlo plant as a dot; the bar is their median, the ring the nominal plant."""
    axes = box.subplots()
    methods = [method for method in found.methods.values() if method.spread is not None]
    for k, method in enumerate(methods):
        assert method.spread is not None
        colour = FAMILIES[method.family]
        _dots(axes, k, method.spread, "o", color=colour, alpha=0.45, markeredgewidth=0)
        axes.semilogx(method.spread.median_um, k, "|", color=colour, markersize=18, markeredgewidth=2.5)
        axes.semilogx(method.track.contour_rms_um, k, "o", color=colour, markersize=8, markerfacecolor="none", mew=1.5)
        if method.retuned is not None:
            _dots(axes, k, method.retuned, "+", color=BAND)
    axes.set_xlabel(
        "contour error, µm rms:  • Monte-Carlo plants   | their median   ○ the printer itself   + tuned again"
    )
    _rows(axes, found, methods)
    plain_decades(axes.xaxis)
    grid(axes, "x")


def _dots(axes: Axes, row: int, spread: Spread, marker: str, **look: Any) -> None:
    """Draw one dot a Monte-Carlo plant, spread over the row's height."""
    values = np.maximum(spread.contour_rms_um, FLOOR_UM)
    axes.semilogx(values, row + 0.25 * np.sin(2.4 * np.arange(len(values))), marker, markersize=4, **look)


def draw_equal_quality(box: Box, found: Comparison) -> None:
    """Draw how fast each method may go, and the print time then."""
    left, right = box.subplots(1, 2, sharey=True)
    methods = [method for method in found.methods.values() if method.equal_quality is not None]
    for k, method in enumerate(methods):
        quality = method.equal_quality
        assert quality is not None
        look = {"color": FAMILIES[method.family], "height": 0.7, "alpha": 1.0 if quality.reached else 0.25}
        sign = "≥ " if quality.capped else "" if quality.reached else "< "
        acceleration = quality.acceleration_mm_per_s2 / 1e3
        left.barh(k, acceleration, **look)
        left.text(acceleration, k, f" {sign}{acceleration:.3g}", va="center", fontsize=8)
        right.barh(k, quality.print_time_s / 60, **look)
        right.text(quality.print_time_s / 60, k, f" {duration(quality.print_time_s)}", va="center", fontsize=8)
    left.set(xlabel="m/s²", title=f"Acceleration for 99 % below {found.quality_bound_um:g} µm")
    right.set(xlabel="minutes", title="The whole print then takes")
    for axes in (left, right):
        axes.margins(x=0.2)
        axes.tick_params(axis="y", length=0)
        grid(axes, "x")
    _rows(left, found, methods)
