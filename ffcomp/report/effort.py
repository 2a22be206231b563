"""Draw accuracy against command acceleration, with the knee that sets a machine's bandwidth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from ffcomp.inverse.bandwidth import EffortCurve
from ffcomp.report.shared.drawing import file_of, layout
from ffcomp.report.shared.style import RC
from gcode.atomic_write import replace_atomically


def draw_effort(curves: Mapping[float, EffortCurve], title: str, path: Path) -> None:
    """Draw one curve for each number of segments a second into `path`, which ends in .png or .svg."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(7.2, 4.6), layout=layout())
        axes = figure.subplots()
        for rate, curve in curves.items():
            peak, knee = curve.peak_mm_per_s2 / 1e3, curve.knee
            label = f"{rate:g} segments/s: {curve.knee_hz:.0f} Hz"
            (line,) = axes.loglog(peak, curve.error_um, ".-", label=label)
            axes.loglog(peak[knee], curve.error_um[knee], "o", ms=10, mfc="none", mew=2, color=line.get_color())
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("{x:g}")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xlabel("peak acceleration of the carriages' command, m/s²")
        axes.set_ylabel("tracking error rms, µm")
        axes.set_title(title)
        axes.legend(title="bandwidth at the knee (circle)", frameon=False)
        axes.grid(True, which="both", alpha=0.25)
        replace_atomically(path, [file_of(figure, "svg" if path.suffix == ".svg" else "png")])
