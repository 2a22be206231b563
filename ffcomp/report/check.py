"""The history of a printer's checks as a figure: how far each was from the machine file, and from the one before."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffcomp.check.compare import CHANGED, SAME, SENSOR, UNKNOWN, CheckResult
from ffcomp.check.history import Check
from ffcomp.report.drawing import SOFT, grid, one_panel

SHOWN = 30  # checks, the last ones
GAP, CHANGE = "#0072b2", "#d55e00"  # distinct for colour-blind readers
MARKED = {CHANGED: "changed", UNKNOWN: "changed", SENSOR: "sensor"}
WORDS = {SAME: "as last time", **MARKED}


def checks_figure(result: CheckResult) -> Figure:
    """Draw the last checks in one panel, the last finding above it."""
    shown, name = list(result.checks)[-SHOWN:], f"{result.machine} · checks: {len(result.checks)}"
    title = f"Last check: {WORDS.get(shown[-1].finding, shown[-1].finding.replace('_', ' '))}"
    return one_panel(title, name, (8.4, 4.2), partial(_panel, shown=shown))


def _panel(axes: Axes, shown: Sequence[Check]) -> None:
    at = list(range(len(shown)))
    axes.plot(at, [100 * each.gap for each in shown], "o-", color=GAP, label="from the machine file")
    compared = [k for k in at if shown[k].difference is not None]
    differences = [100 * (shown[k].difference or 0.0) for k in compared]
    axes.plot(compared, differences, "s-", color=CHANGE, label="from the last check")
    axes.plot(at, [100 * each.noise for each in shown], ":", color=SOFT, label="the sensor's noise in one check")
    for k, difference in zip(compared, differences, strict=True):
        if shown[k].finding in MARKED:
            place = (k, difference)
            axes.annotate(MARKED[shown[k].finding], place, (0, 7), textcoords="offset points", ha="center", fontsize=8)
    axes.set_xticks(at, [each.date.partition("T")[0] for each in shown], rotation=45, ha="right", fontsize=8)
    axes.set_ylabel("difference, % of the signal")
    axes.set_ylim(0.0, 1.2 * axes.get_ylim()[1])
    axes.legend(fontsize=8, frameon=False)
    grid(axes)
