"""List every figure of the comparison with its finding: on the page as SVG, in a folder as PNG and SVG with a band."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ffcomp.comparison.result import Comparison
from ffcomp.numerics.digits import um
from ffcomp.report.compare import charts
from ffcomp.report.compare.charts import comparison_band
from ffcomp.report.compare.close_up import Position, draw_places, worst_positions
from ffcomp.report.compare.words import (
    acceleration,
    contour_rms_um,
    duration,
    fastest_shaper,
    nick,
    shown,
    where_seen,
)
from ffcomp.report.drawing import RC, Box, Drawing, file_of, layout, svg
from gcode.atomic_write import replace_atomically

HOW_TO_READ = {
    "close-up": "The corners with the largest error without compensation, of outer walls if there are any, seen from "
    "above, true to scale. Dashed: the "
    "reference path; grey: its neighbours in the layer. Below, the same pass on a logarithmic scale: how far off the "
    "path the nozzle is, before and behind the corner. Equal waves behind a corner are ringing.",
    "errors-by-layer": "Root mean square of the contour error where plastic flows, if it flows anywhere. On a delta "
    "the resonance changes over the bed, so layers and features that lie elsewhere come out differently; a method that "
    "fits everywhere is flat.",
    "spectrum": "Frequencies at which the nozzle is off the path (density, so that the area under the curve squared is "
    "the mean square error). A hill inside the shaded band is ringing at the resonance; what is left at low "
    "frequencies is corners cut, what is left above is not worth compensating.",
    "bed-map": "The lowest resonance that motion along X or Y excites well, over the bed of the evaluation plant; "
    "black dots: where the evaluated part was printed. An input shaper has one frequency for the whole bed.",
    "limits": "The largest demand on any carriage, over one segment's time, and what the machine file allows (red "
    "line). What is beyond the limit no motor follows: such a method's accuracy is not to be had.",
    "methods": "Every method on the same print and the same virtual printer; left is better, and one "
    "step of the grid is ten times.",
    "mismatch": "How the methods do on printers that are not as the machine file says. A wide spread means that the "
    "method relies on exact numbers.",
    "equal-quality": "The other way round: how hard each method may accelerate before 1 % of its contour error is "
    "above the bound, and how long the whole print takes then. Empty: missed even at the lowest acceleration tried.",
}


def finding(name: str, comparison: Comparison, positions: list[Position]) -> str:
    """Return one line for the title band of a figure."""
    if name == "close-up":
        return _close_up_finding(positions)
    findings = {"bed-map": _bed, "limits": _limits, "mismatch": _mismatch, "equal-quality": _equal_quality}
    return findings.get(name, headline)(comparison)


def headline(comparison: Comparison) -> str:
    """Return `Contour error where plastic flows, rms: 110 µm (no compensation) · 4.94 µm (MZV) · 1.17 µm (ffcomp)`."""
    parts = [f"{um(contour_rms_um(comparison, m))} µm ({nick(m)})" for m in shown(comparison)]
    return f"Contour error {where_seen(comparison)}, rms: {' · '.join(parts)}"


def _close_up_finding(positions: list[Position]) -> str:
    first = positions[0]
    parts = [f"{um(float(each.contour_um.max(initial=0.0)))} µm ({nick(each.method)})" for each in first.passes]
    return f"Largest error, at X {first.at[0]:.1f} Y {first.at[1]:.1f}: {' · '.join(parts)}"


def _bed(comparison: Comparison) -> str:
    assert comparison.bed is not None
    ranges = [
        f"{np.nanmin(values):.0f} to {np.nanmax(values):.0f} Hz along {axis}"
        for axis, values in zip("XY", np.moveaxis(comparison.bed.frequency_hz, 2, 0), strict=True)
    ]
    return f"The resonance of {comparison.plant.name}: {', '.join(ranges)}"


def _limits(comparison: Comparison) -> str:
    beyond = [method.label for method in comparison.methods.values() if not method.peaks.within_limits]
    return f"Beyond the limits: {', '.join(beyond)}" if beyond else "Every method stays within the machine's limits"


def _mismatch(comparison: Comparison) -> str:
    parts = [
        f"{um(m.spread.median_um)} to {um(m.spread.worst_um)} µm ({nick(m)})"
        for m in shown(comparison)
        if m.spread is not None
    ]
    return f"Contour rms, median to worst: {' · '.join(parts)}"


def _equal_quality(comparison: Comparison) -> str:
    methods = (comparison.methods["none"], fastest_shaper(comparison), comparison.methods[comparison.compensated])
    evaluated = [(each, each.equal_quality) for each in methods if each is not None and each.equal_quality is not None]
    parts = [
        f"{acceleration(quality.acceleration_mm_per_s2)}, {duration(quality.print_time_s)} ({method.label})"
        for method, quality in evaluated
        if quality.reached
    ]
    return f"For 99 % below {comparison.quality_bound_um:g} µm: {' · '.join(parts) or 'no method manages it'}"


__all__ = ["close_ups", "drawings", "svg", "write_figures"]

BAND_INCHES, ROW_INCHES = 0.95, 0.24
PANEL_INCHES = 4.4  # wide: its letters are read on a phone


def drawings(comparison: Comparison) -> list[Drawing]:
    """Return the figures in the order of the page, without those that were not requested."""
    positions = worst_positions(comparison)
    rows = ROW_INCHES * len(comparison.methods) + 1.7

    def of(name: str, title: str, width: float, height: float, draw: Callable[..., None]) -> Drawing:
        line = finding(name, comparison, positions)
        return Drawing(name, title, line, HOW_TO_READ[name], width, height, partial(draw, comparison=comparison))

    close_up = partial(draw_places, positions=positions)
    every = [
        of("close-up", "Largest errors", 3.6 * len(positions) + 0.4, 6.2, close_up),
        of("errors-by-layer", "Error by layer and by feature", 11.0, 4.2, charts.draw_layers),
        of("spectrum", "Spectrum of the error", 9.5, 4.2, charts.draw_spectrum),
    ]
    if comparison.bed is not None and comparison.bed.is_round:
        every.append(of("bed-map", "Resonance over the bed", 10.0, 4.6, charts.draw_bed))
    every.append(
        of(
            "limits",
            "What the motors are asked for",
            11.0,
            rows,
            charts.beside(charts.velocities, charts.accelerations),
        )
    )
    every.append(of("methods", "All methods", 10.0, rows, charts.alone(charts.errors)))
    if any(method.spread is not None for method in comparison.methods.values()):
        every.append(
            of("mismatch", "Printers that are not as the file says", 10.0, rows, charts.alone(charts.mismatches))
        )
    if any(method.equal_quality is not None for method in comparison.methods.values()):
        every.append(
            of("equal-quality", "Speed at equal quality", 11.0, rows, charts.beside(charts.fastest, charts.print_times))
        )
    return every


def panels(comparison: Comparison) -> dict[str, list[Drawing]]:
    """Return the figures of the page, each cut into panels that are as narrow as a phone; close-ups apart."""
    rows = ROW_INCHES * len(comparison.methods) + 2.4
    features = 0.26 * len(comparison.methods["none"].by_feature) + 1.6

    def of(draw: Callable[..., None], height: float) -> Drawing:
        return Drawing("", "", "", "", PANEL_INCHES, height, partial(draw, comparison=comparison))

    def lines(panel: charts.Panel, height: float, named: bool = True) -> Drawing:
        return of(partial(_with_methods, panel, named), height)

    every = {
        "errors-by-layer": [lines(charts.by_layer, 3.6), lines(charts.by_feature, max(features, 2.4))],
        "spectrum": [lines(charts.spectra, 4.2, named=False)],
        "bed-map": [lines(partial(charts.bed_map, along=k), 4.3, named=False) for k in (0, 1)],
        "limits": [of(charts.alone(panel), rows) for panel in (charts.velocities, charts.accelerations)],
        "methods": [of(charts.alone(charts.errors), rows)],
        "mismatch": [of(charts.alone(charts.mismatches), rows)],
        "equal-quality": [of(charts.alone(panel), rows) for panel in (charts.fastest, charts.print_times)],
    }
    there = {each.name for each in drawings(comparison)}
    return {name: each for name, each in every.items() if name in there}


def _with_methods(panel: charts.Panel, named: bool, box: Box, comparison: Comparison) -> None:
    panel(box.subplots(), comparison)
    if named:
        charts.method_legend(box, comparison)


def close_ups(comparison: Comparison) -> list[Drawing]:
    """Return the positions of the close-up one by one, for narrow screens."""
    return [_close_up(comparison, position) for position in worst_positions(comparison)]


def _close_up(comparison: Comparison, position: Position) -> Drawing:
    x, y, z = position.at
    draw = partial(draw_places, comparison=comparison, positions=[position])
    return Drawing("close-up", f"X {x:.1f}, Y {y:.1f}, Z {z:.2f} mm", "", "", 3.9, 6.0, draw)


def comparison_figures(comparison: Comparison) -> dict[str, Callable[[], Figure]]:
    """Offer each figure of the report by name; it is drawn when it is called for."""

    def drawn(drawing: Drawing) -> Figure:
        with matplotlib.rc_context(RC):
            return _with_band(drawing, comparison)

    return {drawing.name: partial(drawn, drawing) for drawing in drawings(comparison)}


def write_figures(comparison: Comparison, folder: Path) -> list[Path]:
    """Write PNG and SVG of each figure into `folder`, and return their paths."""
    written = []
    for drawing in drawings(comparison):
        with matplotlib.rc_context(RC):
            figure = _with_band(drawing, comparison)
            for form in ("png", "svg"):
                target = folder / f"{drawing.name}.{form}"
                replace_atomically(target, [file_of(figure, form)])
                written.append(target)
    return written


def _with_band(drawing: Drawing, comparison: Comparison) -> Figure:
    width = max(drawing.width, 10.5)  # the band's lines need it
    figure = Figure(figsize=(width, BAND_INCHES + drawing.height), layout=layout(), facecolor="#ffffff")
    boxes = figure.subfigures(2, 1, height_ratios=(BAND_INCHES, drawing.height), squeeze=False)
    comparison_band(boxes[0, 0], drawing.title, drawing.finding, comparison)
    drawing.draw(boxes[1, 0])
    return figure
