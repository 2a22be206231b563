"""Belts or towers compared: the spectra of their tests, one over the other, with their peaks."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffcomp.identify.belts import BeltComparison
from ffcomp.report.shared.drawing import write_figure
from ffcomp.report.shared.style import BAND, RC, SOFT, grid
from ffcomp.version import __version__

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # told apart by colour-blind people too


def draw_belts(belts: BeltComparison, name: str, target: Path) -> None:
    """Write the figure; the suffix of `target` names the format."""
    write_figure(belts_figure(belts, name), target, dpi=130)


def belts_figure(belts: BeltComparison, name: str) -> Figure:
    """Draw all tests in one panel, its finding above it."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(8.4, 4.7), layout="constrained")
        finding = belts.sentence.partition(". ")[0]
        figure.suptitle(finding, x=0.01, ha="left", fontsize=12, fontweight="bold", color=BAND)
        axes = figure.add_subplot()
        belts_panel(axes, belts)
        axes.set_title(f"{name} · tests along each {belts.kind} · ffcomp {__version__}", fontsize=8, color=SOFT)
    return figure


def belts_panel(axes: Axes, belts: BeltComparison) -> None:
    """Draw each test's power, of any scale: measured, and by the fitted model; its peak is marked."""
    for number, (test, model) in enumerate(zip(belts.tests, belts.fitted, strict=True)):
        colour = COLOURS[number % len(COLOURS)]
        f, scale = test.spectrum.frequency_hz, 1.0 / float(model.max())
        axes.plot(f, scale * test.spectrum.value, color=colour, linewidth=1.8, label=_label(belts, number))
        axes.plot(f, scale * model, color=colour, linewidth=1.0, linestyle=":")
        top = int(np.argmax(test.spectrum.value))
        height = float(scale * test.spectrum.value[top])
        axes.plot(f[top], height, "v", color=colour, markersize=7)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel("power of the acceleration, of its largest")
    axes.set_ylim(bottom=0.0)
    highest = max(float(test.spectrum.frequency_hz[-1]) for test in belts.tests)
    axes.set_xlim(0.0, min(highest, 3.0 * belts.modes_hz[1].value))
    axes.plot([], [], color=SOFT, linewidth=1.0, linestyle=":", label="fitted: head on its belts")
    axes.legend(fontsize=8, frameon=False)
    grid(axes)


def _label(belts: BeltComparison, number: int) -> str:
    """Name a test by its belt and direction."""
    test = belts.tests[number]
    peak = f"peak at {test.spectrum.frequency_hz[int(np.argmax(test.spectrum.value))]:.1f} Hz"
    if belts.kind == "belt":
        return f"axis={test.axis}, {peak}"
    return f"tower {belts.nearest(test)} (axis={test.axis}), {peak}"
