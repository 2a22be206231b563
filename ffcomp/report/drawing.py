"""The style of all figures, deferred drawings, and how they become files or images on a page."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ffcomp.version import __version__
from gcode.atomic_write import replace_atomically
from models.arrays import BoolArray, FloatArray

matplotlib.use("Agg")

# One colour, one meaning, in every figure and on every page; lines have contrast 3 with their ground, words 4.5.
BEFORE, AFTER = "#bd4b00", "#0072b2"  # without compensation or diagnosis, and with it
SHAPER, CALIBRATED = "#007a59", "#6b8e23"  # the best of them, and those that the firmware sets
BEYOND = "#b00020"  # more than the machine allows
REFERENCE = "#222222"
BAND, INK, SOFT, LINE, EDGE, PAPER = "#1f2a37", "#1f2a37", "#6b7280", "#e6e9ee", "#c5cad3", "#ffffff"
NOISE, GROUND = "#c9ced8", "#f5f7fa"  # of a measurement; beneath something
NEIGHBOUR = "#d5d9e0"  # other lines of the layer, and travel: there, but not in question
# How far off the path: from violet, hardly, to what stands out most from the ground. No method has such a colour.
ERROR = ("#9d84c9", "#a55eda", "#a433c7", "#9a05a4", "#860079", "#6e0354", "#501135")
ON_DARK = {  # what each colour becomes where the reader's screen is dark
    BEFORE: "#ff9248",
    AFTER: "#5bb4ea",
    SHAPER: "#3ecf9f",
    CALIBRATED: "#a9cc52",
    BEYOND: "#ff8092",
    REFERENCE: "#f2f5f8",
    INK: "#e3e8ef",
    SOFT: "#a3adba",
    LINE: "#2c3744",
    EDGE: "#4b5868",
    PAPER: "#1a222c",
    NEIGHBOUR: "#3b4857",
    NOISE: "#5b6878",
    GROUND: "#11171e",
    "#56b4e9": "#e6d44c",  # AFTER has it there
    "#6a4c93": "#b79be0",
}
RC: dict[Any, Any] = {
    "font.size": 9,
    "axes.edgecolor": EDGE,
    "axes.labelcolor": INK,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.axisbelow": True,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "svg.hashsalt": "ffcomp",  # the same numbers give the same file
}


def error_colours() -> LinearSegmentedColormap:
    """Return the colours of an error, from hardly to far off the path."""
    return LinearSegmentedColormap.from_list("error", ERROR)


def grid(axes: Axes, axis: Any = "both") -> None:
    """Draw a light grid, and no frame above and to the right."""
    axes.grid(color=LINE, linewidth=0.8, axis=axis)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def plain_decades(axis: Any) -> None:
    """Label a logarithmic axis 0.1, 1, 10, 100 instead of powers; with 1, 2, 5 where there are few."""
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(LogLocator(subs=(1.0,) if high > 50 * low else (1.0, 2.0, 5.0), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


DPI = 150

Box = Figure | SubFigure


@dataclass(frozen=True, eq=False)
class Drawing:
    """One figure, ready to be drawn into any box."""

    name: str  # of the files
    title: str
    finding: str  # its finding in one line
    caption: str  # how to read it
    width: float  # inches
    height: float
    draw: Callable[[Box], None]


def svg(drawing: Drawing | Figure) -> bytes:
    """Return an image for light and dark screens; the page has a drawing's heading and caption as text."""
    with matplotlib.rc_context(RC):
        if isinstance(drawing, Figure):
            figure = drawing
        else:
            figure = Figure(figsize=(drawing.width, drawing.height), layout=layout())
            drawing.draw(figure)
        return _for_dark_screens(file_of(figure, "svg"))


def _for_dark_screens(content: bytes) -> bytes:
    rules = "".join(
        f'[style*="{what}: {light}"]{{{what}:{dark}!important}}'
        for light, dark in ON_DARK.items()
        for what in ("fill", "stroke")
    )
    style = f"<style>@media (prefers-color-scheme: dark){{{rules}}}</style>"
    return content.replace(b"<defs>", f"<defs>{style}".encode(), 1)


COLUMN, PANEL = 4.6, 3.9  # inches: as wide as a phone; a panel's height
MOST_PANELS = 8  # of a figure, that stand apart on a page


def panels(figure: Figure) -> list[bytes]:
    """Return an image of each panel, so that a narrow screen stacks them; one of a figure that has very many.

    Legends of the figure stand below each panel, shortened.
    """
    every = [axes for axes in figure.axes if axes.get_subplotspec() is not None]  # a colour bar has none
    figure.suptitle("")  # the page has these words
    figure.supxlabel("")
    if len(every) > MOST_PANELS:
        return [svg(figure)]
    figure.set_size_inches(COLUMN, PANEL)
    for text in [text for legend in figure.legends for text in legend.get_texts()]:
        text.set_text(text.get_text().partition(":")[0])
    images = []
    for panel in every:
        for axes in figure.axes:
            axes.set_visible(axes is panel)
            axes.set_in_layout(axes is panel)
        panel.set_subplotspec(figure.add_gridspec(1, 1)[0])
        if len(panel.get_shared_x_axes().get_siblings(panel)) > 1:  # the lowest has the words of all
            panel.tick_params(labelbottom=True)
            panel.set_xlabel(every[-1].get_xlabel())
        images.append(svg(figure))
    return images


def figure_of(drawing: Drawing) -> Figure:
    """Draw the figure as a file has it: the title and the finding stand above it."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(drawing.width, drawing.height + 0.6), layout=layout())
        drawing.draw(figure)
        said = textwrap.fill(drawing.finding, int(16 * drawing.width))
        figure.suptitle(f"{drawing.title}\n{said}", x=0.01, ha="left", fontsize=9, parse_math=False)
        return figure


def one_panel(title: str, about: str, size: tuple[float, float], draw: Callable[[Axes], None]) -> Figure:
    """Draw a figure of one panel, with the finding above it; size : inches."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=size, dpi=130, layout="constrained")
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=BAND)
        axes = figure.add_subplot()
        draw(axes)
        axes.set_title(f"{about} · ffcomp {__version__}", fontsize=8, color=SOFT)
        return figure


CLOSEST_MM, WIDEST_MM = 0.4, 2.5  # half the width of a close-up
WIDTH_IN_ERRORS = 8.0  # half the width, in largest errors
Line = tuple[FloatArray, BoolArray, str, float, str]  # points (n, 3) mm, those drawn (n,), colour, width, label


def half_width(error_mm: float) -> float:
    """Return half the width of a close-up, mm, that shows an error."""
    return float(np.clip(WIDTH_IN_ERRORS * error_mm, CLOSEST_MM, WIDEST_MM))


def close_up(axes: Axes, at: FloatArray, half: float, lines: Sequence[Line]) -> None:
    """Draw paths from above, true to scale, with a scale bar.

    at : (3,) mm, the middle
    half : half the width, mm
    """
    for points, keep, colour, width, label in lines:
        shown = np.where(keep[:, None], points[:, :2], np.nan)
        axes.plot(shown[:, 0], shown[:, 1], color=colour, linewidth=width, label=label or "_nolegend_")
    x, y = at[:2] - 0.92 * half
    length = max((n for n in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0) if n <= 0.5 * half), default=0.02)
    axes.plot([x, x + length], [y, y], color=REFERENCE, linewidth=3, solid_capstyle="butt")
    axes.text(x, y + 0.05 * half, f"{1e3 * length:g} µm", fontsize=8)
    limits = {"xlim": (at[0] - half, at[0] + half), "ylim": (at[1] - half, at[1] + half)}
    axes.set(aspect="equal", xticks=[], yticks=[], **limits)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), frameon=False, fontsize=8)


def layout() -> ConstrainedLayoutEngine:
    """Return the layout of every figure."""
    return ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)


def file_of(figure: Figure, form: str, dpi: float = DPI) -> bytes:
    """Return the figure as a file of the form "png", "svg" or "pdf"."""
    file = io.BytesIO()
    with warnings.catch_warnings():  # a print's name may be written in any script: what the font lacks is a box
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(file, format=form, dpi=dpi, metadata={"Date": None} if form == "svg" else None)
    return file.getvalue()


def write_figure(figure: Figure, target: Path) -> None:
    """Write the figure whole or not at all; the suffix of `target` names the format, without one it becomes .png."""
    named = target if target.suffix else target.with_name(f"{target.name}.png")
    content = file_of(figure, named.suffix.removeprefix("."), figure.dpi)
    replace_atomically(named, [_for_dark_screens(content) if named.suffix == ".svg" else content])
