"""The style of all figures."""

from __future__ import annotations

from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

BEFORE, AFTER = "#d55e00", "#0072b2"  # without compensation or diagnosis, and with it
REFERENCE = "#222222"
BAND, INK, SOFT, LINE = "#1f2a37", "#1f2a37", "#6b7280", "#e6e9ee"
RC: dict[Any, Any] = {
    "font.size": 9,
    "axes.edgecolor": "#c5cad3",
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
