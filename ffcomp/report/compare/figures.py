"""Every figure of the comparison: on the page as SVG, in a folder as PNG and SVG with a title band of their own."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ffcomp.compare.result import Comparison
from ffcomp.report.compare import charts
from ffcomp.report.compare.captions import HOW_TO_READ, said
from ffcomp.report.compare.closeup import draw_places
from ffcomp.report.compare.places import Place, worst_places
from ffcomp.report.compare.style import RC, band
from gcode.container import replace_atomically

BAND_INCHES, ROW_INCHES = 0.95, 0.24
DPI = 150


@dataclass(frozen=True, eq=False)
class Drawing:
    """One figure, ready to be drawn into any box."""

    name: str  # of the files
    title: str
    said: str  # its verdict in one line
    how_to_read: str
    width: float  # inches
    height: float
    draw: Callable[[Figure | SubFigure], None]


def drawings(found: Comparison) -> list[Drawing]:
    """In the order of the page; those whose numbers were not asked for are missing."""
    places = worst_places(found)
    rows = ROW_INCHES * len(found.methods) + 1.1

    def of(name: str, title: str, width: float, height: float, draw: Callable[..., None]) -> Drawing:
        line = said(name, found, places)
        return Drawing(name, title, line, HOW_TO_READ[name], width, height, partial(draw, found=found))

    close_up = partial(draw_places, places=places)
    every = [
        of("close-up", "Where it shakes most", 3.6 * len(places) + 0.4, 6.2, close_up),
        of("errors-by-layer", "Error by layer and by feature", 11.0, 4.2, charts.draw_layers),
        of("spectrum", "Spectrum of the error", 9.5, 4.2, charts.draw_spectrum),
    ]
    if found.bed is not None:
        every.append(of("bed-map", "Resonance over the bed", 10.0, 4.6, charts.draw_bed))
    every.append(of("limits", "What the motors are asked for", 11.0, rows, charts.draw_limits))
    every.append(of("methods", "All methods", 10.0, rows, charts.draw_methods))
    if any(method.spread is not None for method in found.methods.values()):
        every.append(of("mismatch", "Printers that are not as the file says", 10.0, rows, charts.draw_mismatch))
    if any(method.equal_quality is not None for method in found.methods.values()):
        every.append(of("equal-quality", "Speed at equal quality", 11.0, rows, charts.draw_equal_quality))
    return every


def close_ups(found: Comparison) -> list[Drawing]:
    """The places of the close-up one by one, for narrow screens."""
    return [_close_up(found, place) for place in worst_places(found)]


def _close_up(found: Comparison, place: Place) -> Drawing:
    x, y, z = place.at
    draw = partial(draw_places, found=found, places=[place])
    return Drawing("close-up", f"X {x:.1f}, Y {y:.1f}, Z {z:.2f} mm", "", "", 3.9, 6.0, draw)


def write_figures(comparison: Comparison, folder: Path) -> list[Path]:
    """PNG and SVG of each figure in `folder`, and their paths."""
    written = []
    for drawing in drawings(comparison):
        with matplotlib.rc_context(RC):
            figure = _with_band(drawing, comparison)
            for form in ("png", "svg"):
                target = folder / f"{drawing.name}.{form}"
                replace_atomically(target, [_bytes(figure, form)])
                written.append(target)
    return written


def svg(drawing: Drawing) -> bytes:
    """The figure alone: on the page, heading and caption are text."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(drawing.width, drawing.height), layout=_layout())
        drawing.draw(figure)
        return _bytes(figure, "svg")


def _with_band(drawing: Drawing, found: Comparison) -> Figure:
    width = max(drawing.width, 10.5)  # the band's lines need it
    figure = Figure(figsize=(width, BAND_INCHES + drawing.height), layout=_layout(), facecolor="#ffffff")
    boxes = figure.subfigures(2, 1, height_ratios=(BAND_INCHES, drawing.height), squeeze=False)
    band(boxes[0, 0], drawing.title, drawing.said, found)
    drawing.draw(boxes[1, 0])
    return figure


def _layout() -> ConstrainedLayoutEngine:
    return ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)


def _bytes(figure: Figure, form: str) -> bytes:
    file = io.BytesIO()
    with warnings.catch_warnings():  # a print's name may be written in any script: what the font lacks is a box
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(file, format=form, dpi=DPI, metadata={"Date": None} if form == "svg" else None)
    return file.getvalue()
