"""Draw the figures over layers, features, frequencies and the bed."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import distance_transform_edt

from ffcomp.compare.result import Comparison
from ffcomp.report.compare import parts
from ffcomp.report.compare.bars import FLOOR_UM, legend
from ffcomp.report.compare.spectrum import HIGHEST_HZ, resonance_band, spectrum
from ffcomp.report.compare.style import colour_of
from ffcomp.report.compare.words import clipped, shown
from ffcomp.report.shared.drawing import Box
from ffcomp.report.shared.style import INK, LINE, REFERENCE, SOFT, grid, plain_decades
from models.arrays import FloatArray

MAP_GRAINS = 120  # dots across the bed map that say where the print was


# ---- by layer, by feature ------------------------------------------------------------------------


def draw_layers(box: Box, found: Comparison) -> None:
    """Draw the error by layer and by feature."""
    left, right = box.subplots(1, 2, width_ratios=(1.5, 1))
    by_layer(left, found)
    by_feature(right, found)
    method_legend(box, found)


def method_legend(box: Box, found: Comparison) -> None:
    """Name the methods that lines and dots belong to."""
    handles = [
        Line2D([], [], color=colour_of(found, method), marker="o", markersize=4, label=clipped(method.label))
        for method in shown(found)
    ]
    legend(box, handles)


def by_layer(axes: Axes, found: Comparison) -> None:
    """Draw a line a method over the layers."""
    for method in shown(found):
        layers = parts.by_layer(found, method)
        numbers = sorted(layers)
        values = [max(layers[n].rms_um, FLOOR_UM) for n in numbers]
        axes.semilogy(numbers, values, "o-", color=colour_of(found, method), markersize=3, linewidth=1.2)
    axes.set(xlabel="layer", ylabel="contour error, µm rms", title="By layer")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    plain_decades(axes.yaxis)
    grid(axes)


def by_feature(axes: Axes, found: Comparison) -> None:
    """Draw a line a feature, the most frequent one on top."""
    none = parts.by_feature(found, found.methods["none"])
    names = sorted(none, key=lambda name: none[name].share)
    for method in shown(found):
        own = parts.by_feature(found, method)
        rows = [(k, own[name].rms_um) for k, name in enumerate(names) if name in own]
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
    spectra(box.subplots(), found)


def spectra(axes: Axes, found: Comparison) -> None:
    """Draw a line a method over the frequencies, and shade those that the printer rings at."""
    if (mode := resonance_band(found)) is not None:
        axes.axvspan(*mode, color=LINE, zorder=0, label=f"resonance where it printed: {mode[0]:.0f}–{mode[1]:.0f} Hz")
    low, top = np.inf, 0.0
    for method in shown(found):
        if (each := spectrum(method, found.sample_s)) is not None:
            amplitude = np.sqrt(each.density_um2_per_hz)
            low, top = min(low, float(amplitude[1:].min())), max(top, float(amplitude.max()))
            line = np.maximum(amplitude, FLOOR_UM)
            axes.semilogy(each.frequency_hz, line, color=colour_of(found, method), lw=1.5, label=clipped(method.label))
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


def draw_bed(box: Box, found: Comparison) -> None:
    """Draw the resonances over the bed."""
    for axes, along in zip(box.subplots(1, 2, sharey=True), (0, 1), strict=True):
        bed_map(axes, found, along)


def bed_map(axes: Axes, found: Comparison, along: int) -> None:
    """Draw the resonance along X (0) or Y (1), in greys that mean nothing else, and where the print stood."""
    assert found.bed is not None
    bed = found.bed
    grain = float(np.ptp(bed.x_mm)) / MAP_GRAINS
    path = grain * np.unique(np.round(found.methods["none"].samples.reference[:, :2] / grain), axis=0)
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
