"""The style of all figures."""

from __future__ import annotations

from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

# One colour, one meaning, in every figure and on every page; lines have contrast 3 with their ground, words 4.5.
BEFORE, AFTER = "#bd4b00", "#0072b2"  # without compensation or diagnosis, and with it
SHAPER, CALIBRATED, SCHEDULED = "#007a59", "#6b8e23", "#7a6a5a"  # the best of them, and those that are set otherwise
BEYOND = "#b00020"  # more than the machine allows
REFERENCE = "#222222"
BAND, INK, SOFT, LINE, EDGE, PAPER = "#1f2a37", "#1f2a37", "#6b7280", "#e6e9ee", "#c5cad3", "#ffffff"
NOISE, GROUND = "#c9ced8", "#f5f7fa"  # of a measurement; beneath something
NEIGHBOUR = "#d5d9e0"  # other lines of the layer, and travel: there, but not in question
# How far off the path: from violet, hardly, to what stands out most from the ground. No method has such a colour.
ERROR = ("#9d84c9", "#a55eda", "#a433c7", "#9a05a4", "#860079", "#6e0354", "#501135")
ERROR_ON_DARK = ("#76609f", "#9458c1", "#bf5be0", "#e669ef", "#fe8cec", "#febbe5", "#fde3ee")
ON_DARK = {  # what each colour becomes where the reader's screen is dark
    BEFORE: "#ff9248",
    AFTER: "#5bb4ea",
    SHAPER: "#3ecf9f",
    CALIBRATED: "#a9cc52",
    SCHEDULED: "#c2b09c",
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


def error_colours(on_dark: bool = False) -> LinearSegmentedColormap:
    """Return the colours of an error, from hardly to far off the path."""
    return LinearSegmentedColormap.from_list("error", ERROR_ON_DARK if on_dark else ERROR)


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
