"""Draw a compensated print next to its original: the largest error from near, the layer, and the error by layer."""

from __future__ import annotations

from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from ffcomp.compensation.result import CompensatedFile
from ffcomp.errors import RequestError
from ffcomp.report.drawing import (
    AFTER,
    BEFORE,
    RC,
    REFERENCE,
    SOFT,
    close_up,
    error_colours,
    grid,
    half_width,
    plain_decades,
)
from ffcomp.simulation.forecast import Forecast
from ffcomp.simulation.preview import Curve, Preview, preview
from ffcomp.simulation.simulation import Simulation
from ffcomp.version import __version__
from gcode.container import read_bytes
from models.arrays import BoolArray, FloatArray

WIDTH, LETTERS = 7.2, 88  # inches: readable on a phone; letters across the picture
LAYER_MM = 0.15  # half the height of what counts as one layer
SETTLE_S = 0.5  # at the beginning: the nozzle may come from anywhere
MAP_GROUND = "#f6f6f8"  # under the colours of the error, on dark screens too
LEAST_UM = 0.01  # smaller errors are drawn as this


def show_figure(
    preview: Preview, forecast: Forecast, title: str, footer: str = "", z_mm: float | None = None
) -> Figure:
    """Draw the uncompensated and the compensated path where plastic flows; travel and wipes are left out.

    forecast : the errors that stand above the figure
    z_mm : the layer to show; None: the one with the largest error before, on an outer wall if there is any
    """
    at, error_mm = _worst(preview.before, z_mm)
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(WIDTH, 7.6), dpi=200, layout="constrained")
        lines = [title, forecast.expected.headline if forecast.expected else "", forecast.verdict]
        text = "\n".join(fill(line, LETTERS) for line in lines if line)
        figure.suptitle(text, fontsize=10, x=0.01, ha="left", parse_math=False)
        rows: list[Any] = [["close", "layers"], ["before", "after"]]
        panels = figure.subplot_mosaic(rows, height_ratios=[1.1, 1.0])
        _close_up(panels["close"], preview, at, half_width(error_mm))
        _by_layer(panels["layers"], preview)
        _maps(figure, panels["before"], panels["after"], preview, at)
        figure.supxlabel(fill(footer, 2 * LETTERS), fontsize=6, color=SOFT)
    return figure


def compensation_figure(done: CompensatedFile, *, z_mm: float | None = None) -> Figure:
    """Draw the paths of a compensated file; see `show_figure`.

    Raises RequestError if no file was written.
    """
    if done.output is None:
        raise RequestError("Nothing was written, so there is nothing to draw: name an output.")
    seen = preview(read_bytes(done.output, None), str(done.output), done.machine)
    return show_figure(seen, done.result.forecast, f"{done.output.name} on {done.machine.name}", z_mm=z_mm)


def _worst(curve: Curve, z_mm: float | None) -> tuple[FloatArray, float]:
    """Return the reference position (3,) mm where the error is largest, after the start, and the error, mm."""
    settled = curve.t > curve.t[0] + SETTLE_S
    if z_mm is not None:
        settled &= np.abs(curve.reference[:, 2] - z_mm) < LAYER_MM
    kinds = (curve.outer_wall, curve.extruding, np.ones(len(curve.t), dtype=np.bool_))  # visible walls first
    candidates = next((settled & kind for kind in kinds if (settled & kind).any()), kinds[-1])
    k = int(np.argmax(np.where(candidates, curve.contour, -1.0)))
    return curve.reference[k], float(curve.contour[k])


def _near(curve: Curve, at: FloatArray, reach_mm: float = np.inf) -> BoolArray:
    """Return where plastic flows in the layer (all moves if it flows nowhere), and no further away than this."""
    away = np.abs(curve.reference - at)
    return curve.shows & (away[:, 2] < LAYER_MM) & (away[:, :2].max(axis=1) < reach_mm)


def _close_up(axes: Axes, preview: Preview, at: FloatArray, half: float) -> None:
    before, after = (_near(curve, at, 2 * half) for curve in (preview.before, preview.after))
    close_up(
        axes,
        at,
        half,
        [
            (preview.before.nozzle, before, BEFORE, 1.6, "without compensation"),
            (preview.after.nozzle, after, AFTER, 2.2, "with compensation"),
            (preview.before.reference, before, REFERENCE, 0.8, "reference"),
        ],
    )
    k = int(np.argmin(np.abs(preview.before.reference - at).max(axis=1)))
    wall = " on an outer wall" if preview.before.outer_wall[k] else ""
    axes.set_title(f"Largest error{wall}:\nX {at[0]:.1f}, Y {at[1]:.1f}, Z {at[2]:.2f} mm")


def _by_layer(axes: Axes, preview: Preview) -> None:
    for curve, colour, name in ((preview.before, BEFORE, "without"), (preview.after, AFTER, "with")):
        z_mm, error_um = curve.by_height()
        axes.semilogx(
            np.maximum(error_um, LEAST_UM), z_mm, ".-", color=colour, linewidth=1, label=f"{name} compensation"
        )
    axes.set(xlabel="contour error, µm rms", ylabel="Z, mm", title="Error by layer")
    plain_decades(axes.xaxis)
    grid(axes)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False, fontsize=8)


def _maps(figure: Figure, left: Axes, right: Axes, preview: Preview, at: FloatArray) -> None:
    """Draw the layer where plastic flows, coloured by error on one scale."""
    norm, colours = LogNorm(0.5, max(500.0, 1e3 * float(preview.before.contour.max()))), error_colours()
    for axes, curve, name in ((left, preview.before, "without"), (right, preview.after, "with")):
        inside = _near(curve, at)
        joined = inside[1:] & inside[:-1]
        pieces = np.stack([curve.nozzle[:-1, :2], curve.nozzle[1:, :2]], axis=1)[joined]
        lines = LineCollection(list(pieces), cmap=colours, norm=norm, linewidths=1.2, rasterized=True)
        lines.set_array(np.maximum(1e3 * curve.contour[1:][joined], 0.5))
        axes.add_collection(lines)
        axes.autoscale_view()
        axes.set(aspect="equal", xlabel="X, mm", ylabel="Y, mm", facecolor=MAP_GROUND)
        axes.set_title(f"Z {at[2]:.2f} mm, {name} compensation")
        axes.tick_params(labelsize=8)
        scale = axes.inset_axes((1.03, 0.0, 0.04, 1.0))  # it stays with its map on a page
        figure.colorbar(ScalarMappable(norm, colours), cax=scale, label="contour error, µm", format="{x:g}")


def simulation_figure(result: Simulation) -> Figure:
    """Draw the reference and the nozzle's path where the contour error is largest, and the error over time."""
    track, worst = result.track, int(np.argmax(result.error_um))
    at, half = result.reference_mm[worst], half_width(1e-3 * float(result.error_um[worst]))
    away = np.abs(result.reference_mm - at)
    near = (away[:, 2] < LAYER_MM) & (away[:, :2].max(axis=1) < 2 * half)
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(9, 4.4), layout="constrained")
        said = f"{result.plant.name}: contour error {track.contour_rms_um:.2f} µm rms, 99 % below "
        said += f"{track.contour_p99_um:.1f} µm, largest {track.contour_max_um:.0f} µm · ffcomp {__version__}"
        figure.suptitle(said, x=0.01, ha="left", fontsize=10, parse_math=False)
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.5))
        lines: Any = [
            (result.nozzle_mm, near, AFTER, 1.6, "nozzle"),
            (result.reference_mm, near, REFERENCE, 0.8, "reference"),
        ]
        close_up(left, at, half, lines)
        left.set_title(f"Largest error, at {result.time_s[worst]:.2f} s")
        right.semilogy(result.time_s, np.maximum(result.error_um, LEAST_UM), color=AFTER, linewidth=0.6)
        right.set(xlabel="time, s", ylabel="contour error, µm", title="Over time")
        plain_decades(right.yaxis)
        grid(right)
    return figure
