"""List every figure of the comparison: on the page as SVG, in a folder as PNG and SVG with a title band."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from ffcomp.compare.result import Comparison
from ffcomp.report.compare import bars, charts
from ffcomp.report.compare.captions import HOW_TO_READ, said
from ffcomp.report.compare.closeup import draw_places
from ffcomp.report.compare.positions import Position, worst_positions
from ffcomp.report.compare.style import band
from ffcomp.report.shared.drawing import Box, Drawing, file_of, layout, svg
from ffcomp.report.shared.style import RC
from gcode.atomic_write import replace_atomically

__all__ = ["close_ups", "drawings", "svg", "write_figures"]

BAND_INCHES, ROW_INCHES = 0.95, 0.24
PANEL_INCHES = 4.4  # wide: its letters are read on a phone


def drawings(found: Comparison) -> list[Drawing]:
    """Return the figures in the order of the page, without those that were not requested."""
    positions = worst_positions(found)
    rows = ROW_INCHES * len(found.methods) + 1.7

    def of(name: str, title: str, width: float, height: float, draw: Callable[..., None]) -> Drawing:
        line = said(name, found, positions)
        return Drawing(name, title, line, HOW_TO_READ[name], width, height, partial(draw, found=found))

    close_up = partial(draw_places, positions=positions)
    every = [
        of("close-up", "Largest errors", 3.6 * len(positions) + 0.4, 6.2, close_up),
        of("errors-by-layer", "Error by layer and by feature", 11.0, 4.2, charts.draw_layers),
        of("spectrum", "Spectrum of the error", 9.5, 4.2, charts.draw_spectrum),
    ]
    if found.bed is not None and found.bed.is_round:
        every.append(of("bed-map", "Resonance over the bed", 10.0, 4.6, charts.draw_bed))
    every.append(
        of("limits", "What the motors are asked for", 11.0, rows, bars.beside(bars.velocities, bars.accelerations))
    )
    every.append(of("methods", "All methods", 10.0, rows, bars.alone(bars.errors)))
    if any(method.spread is not None for method in found.methods.values()):
        every.append(of("mismatch", "Printers that are not as the file says", 10.0, rows, bars.alone(bars.mismatches)))
    if any(method.equal_quality is not None for method in found.methods.values()):
        every.append(
            of("equal-quality", "Speed at equal quality", 11.0, rows, bars.beside(bars.fastest, bars.print_times))
        )
    return every


def panels(found: Comparison) -> dict[str, list[Drawing]]:
    """Return the figures of the page, each cut into panels that are as narrow as a phone; close-ups apart."""
    rows = ROW_INCHES * len(found.methods) + 2.4
    features = 0.26 * len(found.methods["none"].by_feature) + 1.6

    def of(draw: Callable[..., None], height: float) -> Drawing:
        return Drawing("", "", "", "", PANEL_INCHES, height, partial(draw, found=found))

    def lines(panel: bars.Panel, height: float, named: bool = True) -> Drawing:
        return of(partial(_with_methods, panel, named), height)

    every = {
        "errors-by-layer": [lines(charts.by_layer, 3.6), lines(charts.by_feature, max(features, 2.4))],
        "spectrum": [lines(charts.spectra, 4.2, named=False)],
        "bed-map": [lines(partial(charts.bed_map, along=k), 4.3, named=False) for k in (0, 1)],
        "limits": [of(bars.alone(panel), rows) for panel in (bars.velocities, bars.accelerations)],
        "methods": [of(bars.alone(bars.errors), rows)],
        "mismatch": [of(bars.alone(bars.mismatches), rows)],
        "equal-quality": [of(bars.alone(panel), rows) for panel in (bars.fastest, bars.print_times)],
    }
    there = {each.name for each in drawings(found)}
    return {name: each for name, each in every.items() if name in there}


def _with_methods(panel: bars.Panel, named: bool, box: Box, found: Comparison) -> None:
    panel(box.subplots(), found)
    if named:
        charts.method_legend(box, found)


def close_ups(found: Comparison) -> list[Drawing]:
    """Return the positions of the close-up one by one, for narrow screens."""
    return [_close_up(found, position) for position in worst_positions(found)]


def _close_up(found: Comparison, position: Position) -> Drawing:
    x, y, z = position.at
    draw = partial(draw_places, found=found, positions=[position])
    return Drawing("close-up", f"X {x:.1f}, Y {y:.1f}, Z {z:.2f} mm", "", "", 3.9, 6.0, draw)


def comparison_figures(found: Comparison) -> dict[str, Callable[[], Figure]]:
    """Offer each figure of the report by name; it is drawn when it is called for."""

    def drawn(drawing: Drawing) -> Figure:
        with matplotlib.rc_context(RC):
            return _with_band(drawing, found)

    return {drawing.name: partial(drawn, drawing) for drawing in drawings(found)}


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


def _with_band(drawing: Drawing, found: Comparison) -> Figure:
    width = max(drawing.width, 10.5)  # the band's lines need it
    figure = Figure(figsize=(width, BAND_INCHES + drawing.height), layout=layout(), facecolor="#ffffff")
    boxes = figure.subfigures(2, 1, height_ratios=(BAND_INCHES, drawing.height), squeeze=False)
    band(boxes[0, 0], drawing.title, drawing.said, found)
    drawing.draw(boxes[1, 0])
    return figure
