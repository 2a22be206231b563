"""What all figures of the comparison look like."""

from __future__ import annotations

from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ffcomp.compare.result import Comparison, Family, Method
from ffcomp.report.compare.words import file_name

WANTED, NONE, BEST, OURS = "#222222", "#d55e00", "#009e73", "#0072b2"
BAND, INK, SOFT, LINE = "#1f2a37", "#1f2a37", "#6b7280", "#e6e9ee"
FAMILIES: dict[Family, str] = {
    "none": NONE,
    "calibrated": "#cc79a7",
    "best fixed": BEST,
    "scheduled": "#b8860b",
    "inversion": OURS,
}
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


def colour_of(found: Comparison, method: Method) -> str:
    """Of the three methods that pictures show."""
    return {found.ours: OURS, found.best_fixed: BEST}.get(method.name, NONE)


def grid(axes: Axes, axis: Any = "both") -> None:
    axes.grid(color=LINE, linewidth=0.8, axis=axis)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def plain_decades(axis: Any) -> None:
    """0.1, 1, 10, 100 on a logarithmic axis, not powers; 1, 2, 5 where there are few."""
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(LogLocator(subs=(1.0,) if high > 50 * low else (1.0, 2.0, 5.0), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def band(box: SubFigure, title: str, said: str, found: Comparison) -> None:
    """Title, verdict, and of what print, machine and program this is."""
    box.add_artist(Rectangle((0, 0), 1, 1, color=BAND, transform=box.transSubfigure, zorder=-1))
    of = f"{file_name(found)}  ·  {found.machine.name}, machine file sha256 {found.machine.sha256[:12]}"
    by = f"judged by {found.plant.name}  ·  ffcomp {found.version}"
    rows = ((0.74, title, 14, "bold", "#ffffff"), (0.44, said, 10, "normal", "#ffd08a"))
    for y, text, size, weight, colour in (*rows, (0.17, f"{of}  ·  {by}", 8, "normal", "#b9c2cf")):
        box.text(0.015, y, text, fontsize=size, weight=weight, color=colour, va="center", parse_math=False, wrap=True)
