"""Deferred figures, and how they become files or images on a page."""

from __future__ import annotations

import base64
import io
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ffcomp.report.shared.style import ON_DARK, RC
from gcode.atomic_write import replace_atomically

DPI = 150

Box = Figure | SubFigure


@dataclass(frozen=True, eq=False)
class Drawing:
    """One figure, ready to be drawn into any box."""

    name: str  # of the files
    title: str
    said: str  # its finding in one line
    how_to_read: str
    width: float  # inches
    height: float
    draw: Callable[[Box], None]


def svg(drawing: Drawing) -> bytes:
    """Draw the figure alone, for light and dark screens: on the page, heading and caption are text."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(drawing.width, drawing.height), layout=layout())
        drawing.draw(figure)
        return _for_dark_screens(file_of(figure, "svg"))


def _for_dark_screens(content: bytes) -> bytes:
    """Give an SVG a second set of colours, for readers whose screen is dark."""
    rules = "".join(
        f'[style*="{what}: {light}"]{{{what}:{dark}!important}}'
        for light, dark in ON_DARK.items()
        for what in ("fill", "stroke")
    )
    style = f"<style>@media (prefers-color-scheme: dark){{{rules}}}</style>"
    return content.replace(b"<defs>", f"<defs>{style}".encode(), 1)


def layout() -> ConstrainedLayoutEngine:
    """Return the layout of every figure."""
    return ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)


def file_of(figure: Figure, form: str) -> bytes:
    """Return the figure as a file of the form "png" or "svg"."""
    file = io.BytesIO()
    with warnings.catch_warnings():  # a print's name may be written in any script: what the font lacks is a box
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(file, format=form, dpi=DPI, metadata={"Date": None} if form == "svg" else None)
    return file.getvalue()


def write_figure(figure: Figure, target: Path, dpi: float) -> None:
    """Write the figure whole or not at all; the suffix of `target` names the format, without one it becomes .png."""
    named = target if target.suffix else target.with_name(f"{target.name}.png")
    content = io.BytesIO()
    figure.savefig(content, format=named.suffix.removeprefix("."), dpi=dpi)
    replace_atomically(named, [content.getvalue()])


@dataclass(frozen=True, slots=True)
class Image:
    """A figure inside a page."""

    title: str
    said: str
    data: str  # base64 of SVG
    width: int
    height: int


def panel(drawing: Drawing) -> Image:
    """Draw and embed one panel of a figure."""
    return image(drawing, svg(drawing))


def image(drawing: Drawing, content: bytes) -> Image:
    """Embed a drawing, given as SVG."""
    data = base64.b64encode(content).decode("ascii")
    return Image(drawing.title, drawing.said, data, round(96 * drawing.width), round(96 * drawing.height))
