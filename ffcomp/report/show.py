"""Draw a compensated print beside its original: reference, before and after, close up, over a layer, along the time."""

from __future__ import annotations

from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from ffcomp.compensation.result import CompensatedFile
from ffcomp.errors import RequestError
from ffcomp.report.drawing import AFTER, BEFORE, NEIGHBOUR, REFERENCE, error_colours, plain_decades, write_figure
from ffcomp.simulation.forecast import Forecast
from ffcomp.simulation.preview import Curve, Flow, Preview, preview
from ffcomp.simulation.simulation import Simulation
from ffcomp.version import __version__
from gcode.container import read_bytes
from gcode.embedded import STAMP_REACH, already_processed, find_offset
from models.arrays import BoolArray, FloatArray

TITLE_COLUMNS = 150  # letters across the picture
CLOSE_UP_MM = 2.5  # half the width of the close-up
LAYER_MM = 0.15  # half the height of what counts as one layer
TRAVEL_WIDTH = 0.6  # of lines, points: nothing is printed there
RETIMED_SHARE = 0.02  # share of its time, by which a print is shorter or longer, for speeds to be drawn
SETTLE_S = 0.5  # at the beginning: the nozzle may come from anywhere


def draw(
    preview: Preview, forecast: Forecast, title: str, footer: str, target: Path, z_mm: float | None = None
) -> None:
    """Write the picture; the suffix of `target` names the format. See `show_figure`."""
    write_figure(show_figure(preview, forecast, title, footer, z_mm), target, dpi=100)


def show_figure(
    preview: Preview, forecast: Forecast, title: str, footer: str = "", z_mm: float | None = None
) -> Figure:
    """Draw the reference, the uncompensated and the compensated path.

    Parameters
    ----------
    forecast : the errors that stand above the figure
    z_mm : the layer to show; None: the one with the largest error before, on an outer wall if there is any
    """
    worst = _worst_position(preview.before, z_mm)
    figure = Figure(figsize=(16, 8.4), layout="constrained")
    lines = wrap(forecast.expected.headline, TITLE_COLUMNS) if forecast.expected else []
    text = "\n".join([title, *lines, forecast.verdict])
    figure.suptitle(text, fontsize=13, x=0.01, ha="left")
    rows, heights = _rows(preview)
    rooms = figure.subplot_mosaic(rows, height_ratios=heights)
    _close_up(rooms["close"], preview, worst)
    _layer_maps(figure, rooms["before"], rooms["after"], preview, worst)
    _along_time(rooms["time"], preview, worst)
    if retimed(preview):
        _speeds(rooms["speed"], preview, worst)
    if preview.flows is not None:
        _flows(rooms["flow"], preview, preview.flows, worst)
    figure.supxlabel(footer, fontsize=8, color="#666666")
    return figure


def compensation_figure(done: CompensatedFile, *, z_mm: float | None = None) -> Figure:
    """Draw the paths of a compensated file; see `show_figure`.

    Raises
    ------
    RequestError
        If no file was written.
    """
    if done.output is None:
        raise RequestError("Nothing was written, so there is nothing to draw: name an output.")
    data = read_bytes(done.output, None)
    stamp = already_processed(data)
    flavor = stamp.flavor if stamp else None
    seen = preview(data, str(done.output), done.machine, find_offset(data[:STAMP_REACH]), flavor)
    return show_figure(seen, done.result.forecast, f"{done.output.name} on {done.machine.name}", z_mm=z_mm)


def _rows(preview: Preview) -> tuple[list[Any], list[float]]:
    names = [name for name, there in (("speed", retimed(preview)), ("flow", preview.flows is not None)) if there]
    heights = [2.2, 0.8 if names else 1.0, *(0.6 for _ in names)]
    return [["close", "before", "after"], ["time"] * 3, *([name] * 3 for name in names)], heights


def _flows(axes: Axes, preview: Preview, flows: tuple[Flow, Flow], position: FloatArray) -> None:
    for curve, flow, colour, name in (
        (preview.before, flows[0], BEFORE, "flow as sliced"),
        (preview.after, flows[1], AFTER, "flow now"),
    ):
        inside = np.flatnonzero(np.abs(curve.reference[:, 2] - position[2]) < LAYER_MM)
        if inside.size > 1:
            t = curve.t[inside[0] : inside[-1] + 1]
            axes.plot(t - t[0], flow.at(t), color=colour, linewidth=0.8, label=name)
            if colour == BEFORE:
                wanted = np.interp(t, flow.t, np.maximum(flow.pushed, 0.0))
                axes.plot(t - t[0], wanted, color=REFERENCE, linewidth=0.6, label="wanted as sliced")
    axes.set(xlabel="time in this layer, s", ylabel="filament, mm/s", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)


def retimed(preview: Preview) -> bool:
    """Tell whether the print takes another time than its original: then speeds are of interest too."""
    before_s, after_s = (float(curve.t[-1] - curve.t[0]) for curve in (preview.before, preview.after))
    return abs(after_s - before_s) > RETIMED_SHARE * before_s


def _speeds(axes: Axes, preview: Preview, position: FloatArray) -> None:
    """Draw how fast the nozzle is in the layer, on each print's own clock: where the shorter one wins its time."""
    for curve, colour, name in ((preview.before, BEFORE, "as sliced"), (preview.after, AFTER, "now")):
        inside = np.flatnonzero(np.abs(curve.reference[:, 2] - position[2]) < LAYER_MM)
        if inside.size > 1:
            part = slice(int(inside[0]), int(inside[-1]) + 1)
            t = curve.t[part]
            way = np.sqrt((np.diff(curve.nozzle[part], axis=0) ** 2).sum(axis=1))
            label = f"{name}: {t[-1] - t[0]:.1f} s for this layer"
            axes.plot(t[1:] - t[0], way / np.diff(t), color=colour, linewidth=0.8, label=label)
    axes.set(xlabel="time in this layer, s", ylabel="speed, mm/s", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)


def _worst_position(curve: Curve, z_mm: float | None) -> FloatArray:
    """Return the reference position (3,) mm, after the start, where the error without compensation shows most."""
    settled = curve.t > curve.t[0] + SETTLE_S
    if z_mm is not None:
        settled &= np.abs(curve.reference[:, 2] - z_mm) < LAYER_MM
    kinds = (curve.outer_wall, curve.extruding, np.ones(len(curve.t), dtype=np.bool_))  # what is seen, first
    candidates = next((settled & kind for kind in kinds if (settled & kind).any()), kinds[-1])
    return curve.reference[int(np.argmax(np.where(candidates, curve.contour, -1.0)))]


def _close_up(axes: Axes, preview: Preview, position: FloatArray) -> None:
    """Draw the worst corner in its layer: parts of the curves that pass through the window."""
    for curve, colour, label, width in (
        (preview.before, BEFORE, "without compensation", 1.6),
        (preview.after, AFTER, "with compensation", 2.2),
    ):
        inside = _near(curve, position, 2 * CLOSE_UP_MM)
        _lines(axes, curve.nozzle, inside & ~curve.extruding, colour, TRAVEL_WIDTH)
        _lines(axes, curve.nozzle, inside & curve.extruding, colour, width, label)
    x, y, z = position
    path = np.abs(preview.path[:, 2] - z) < LAYER_MM
    _lines(axes, preview.path, path, REFERENCE, 0.8, "reference")
    axes.set(
        xlim=(position[0] - CLOSE_UP_MM, position[0] + CLOSE_UP_MM),
        ylim=(position[1] - CLOSE_UP_MM, position[1] + CLOSE_UP_MM),
        xlabel="X, mm",
        ylabel="Y, mm",
        aspect="equal",
        title=f"Largest error{_of(preview, position)}: X {x:.1f}, Y {y:.1f}, Z {z:.2f} mm",
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=1, frameon=False)
    _scale_bar(axes, position)


def _scale_bar(axes: Axes, position: FloatArray) -> None:
    x, y = position[0] - 0.9 * CLOSE_UP_MM, position[1] - 0.9 * CLOSE_UP_MM
    axes.plot([x, x + 0.5], [y, y], color=REFERENCE, linewidth=3, solid_capstyle="butt")
    axes.text(x + 0.25, y + 0.05 * CLOSE_UP_MM, "500 µm", ha="center", backgroundcolor="#ffffffcc")


def _of(preview: Preview, position: FloatArray) -> str:
    at = int(np.argmin(np.abs(preview.before.reference - position).max(axis=1)))
    return " on an outer wall" if preview.before.outer_wall[at] else ""


def _layer_maps(figure: Figure, above: Axes, below: Axes, preview: Preview, position: FloatArray) -> None:
    """Draw the whole layer, coloured by error where plastic flows, both on one scale; travel is thin and grey."""
    norm, colours = LogNorm(0.5, max(500.0, 1e3 * float(preview.before.contour.max()))), error_colours()
    for axes, curve, name in ((above, preview.before, "without"), (below, preview.after, "with")):
        inside = np.abs(curve.reference[:, 2] - position[2]) < LAYER_MM
        _lines(axes, curve.nozzle, inside & ~curve.extruding, NEIGHBOUR, TRAVEL_WIDTH, "travel")
        inside &= curve.extruding
        joined = inside[1:] & inside[:-1]
        pieces = np.stack([curve.nozzle[:-1, :2], curve.nozzle[1:, :2]], axis=1)[joined]
        lines = LineCollection(list(pieces), cmap=colours, norm=norm, linewidths=1.2)
        lines.set_array(np.maximum(1e3 * curve.contour[1:][joined], 0.5))
        axes.add_collection(lines)
        axes.autoscale_view()
        axes.set(
            aspect="equal",
            xlabel="X, mm",
            ylabel="Y, mm",
            title=f"Layer at Z {position[2]:.2f} mm, {name} compensation",
        )
        axes.tick_params(labelsize=8)
    above.legend(loc="upper left", frameon=False, fontsize=8)
    bar = figure.colorbar(
        ScalarMappable(norm, colours), ax=[above, below], label="contour error where plastic flows, µm"
    )
    bar.ax.yaxis.set_major_formatter("{x:g}")


def _along_time(axes: Axes, preview: Preview, position: FloatArray) -> None:
    """Draw the error of this layer along its time; the numbers of the whole print stand above the figure."""
    for curve, colour, name in ((preview.before, BEFORE, "without"), (preview.after, AFTER, "with")):
        inside = np.flatnonzero(np.abs(curve.reference[:, 2] - position[2]) < LAYER_MM)
        if inside.size:
            part = slice(int(inside[0]), int(inside[-1]) + 1)
            error = np.maximum(1e3 * curve.contour[part], 0.01)
            t = curve.t[part] - curve.t[part][0]
            axes.semilogy(t, error, color=colour, linewidth=0.6, label=f"{name} compensation")
    axes.set(xlabel="time in this layer, s", ylabel="contour error, µm", ylim=(0.05, None))
    plain_decades(axes.yaxis)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)


def _near(curve: Curve, position: FloatArray, reach: float) -> BoolArray:
    away = np.abs(curve.reference - position)
    return (away[:, 2] < LAYER_MM) & (away[:, :2].max(axis=1) < reach)


def _lines(
    axes: Axes, points: FloatArray, keep: BoolArray, colour: str, width: float, label: str = "_nolegend_"
) -> None:
    shown = np.where(keep[:, None], points[:, :2], np.nan)
    axes.plot(shown[:, 0], shown[:, 1], color=colour, linewidth=width, label=label)


LEAST_UM = 0.01  # smaller errors are drawn as this


def simulation_figure(result: Simulation) -> Figure:
    """Draw the reference and the nozzle's path where the contour error is largest, and the error along the time."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    track = result.track
    figure.suptitle(
        f"{result.plant.name}: contour error {track.contour_rms_um:.2f} µm rms, 99 % below "
        f"{track.contour_p99_um:.1f} µm, largest {track.contour_max_um:.0f} µm",
        x=0.01,
        ha="left",
    )
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.7))
    _simulated_close_up(left, result)
    right.semilogy(result.time_s, np.maximum(result.error_um, LEAST_UM), color=AFTER, linewidth=0.6)
    right.set(xlabel="time, s", ylabel="contour error, µm", title="Along the time")
    right.grid(alpha=0.3)
    figure.supxlabel(f"ffcomp v{__version__}", fontsize=7, x=0.99, ha="right")
    return figure


def _simulated_close_up(axes: Axes, result: Simulation) -> None:
    worst = int(np.argmax(result.error_um))
    centre = result.reference_mm[worst]
    away = np.abs(result.reference_mm - centre)
    near = (away[:, 2] < 0.15) & (away[:, :2].max(axis=1) < 2 * CLOSE_UP_MM)
    for points, colour, label in ((result.nozzle_mm, AFTER, "nozzle"), (result.reference_mm, REFERENCE, "reference")):
        shown = np.where(near[:, None], points[:, :2], np.nan)
        axes.plot(shown[:, 0], shown[:, 1], color=colour, linewidth=1.0, label=label)
    axes.set(
        xlim=(centre[0] - CLOSE_UP_MM, centre[0] + CLOSE_UP_MM),
        ylim=(centre[1] - CLOSE_UP_MM, centre[1] + CLOSE_UP_MM),
        xlabel="X, mm",
        ylabel="Y, mm",
        aspect="equal",
        title=f"Largest error, at {result.time_s[worst]:.2f} s",
    )
    axes.legend(frameon=False, loc="best")
