"""Draw the time of a print: each layer by kind of motion, and each feature."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ffcomp.estimation.engine import Estimate, seconds
from ffcomp.estimation.statistics import BEFORE, KINDS, WAITING, Statistics
from ffcomp.report.drawing import RC, grid, layout
from ffcomp.version import __version__
from gcode.metadata import short

COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#b8bec9")  # as KINDS
MOST_FEATURES = 14


def estimate_figure(estimate: Estimate) -> Figure:
    """Draw the time by layer and by feature."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(6.4, 6.8), dpi=150, layout=layout())
        above, below = figure.subplots(2, 1)
        _layers(above, estimate.statistics)
        _features(below, estimate.statistics)
        title = f"{Path(estimate.path).name} on {estimate.machine.name}: {short(estimate.time_s)}"
        figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
        note = f"planned like the firmware; without heating, homing and macros; ffcomp v{__version__}"
        figure.supxlabel(note, x=0.99, ha="right", fontsize=7)
        return figure


def _layers(axes: Axes, statistics: Statistics) -> None:
    layers = statistics.layers_in_order
    number = np.array([layer.number for layer in layers])
    rows = np.stack([layer.row[: WAITING + 1] for layer in layers]) / 60
    below = np.zeros(len(rows))
    edges = np.append(number, number[-1] + 1) - 0.5
    for kind, column, colour in zip(KINDS, rows.T, COLOURS, strict=True):
        if column.any():
            axes.stairs(below + column, edges, baseline=below, fill=True, color=colour, label=kind, lw=0)
            below = below + column
    axes.set_xlabel("layer (-1: start of the file)" if number[0] == BEFORE else "layer")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.set_ylabel("minutes")
    axes.set_title("by layer")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=5, frameon=False)
    grid(axes, "y")


def _features(axes: Axes, statistics: Statistics) -> None:
    names = sorted(statistics.features, key=lambda name: seconds(statistics.features[name]))[-MOST_FEATURES:]
    left = np.zeros(len(names))
    rows = np.stack([statistics.features[name][: WAITING + 1] for name in names]) / 60
    for column, colour in zip(rows.T, COLOURS, strict=True):
        axes.barh(names, column, left=left, color=colour)
        left += column
    axes.set_xlabel("minutes")
    axes.set_title("by feature")
    grid(axes, "x")
