"""The picture of a page with the fit over it, and each line's waves."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ffcomp.identification.machine_fit import ScanFit
from ffcomp.report.drawing import AFTER, BAND, RC, REFERENCE, SOFT, grid, write_figure
from ffcomp.version import __version__

COLUMNS, MAGNIFIED = 5, 20.0


def draw_page(fit: ScanFit, target: Path) -> None:
    """Write the figure; the suffix of `target` names the format."""
    write_figure(page_figure(fit), target, dpi=110)


def page_figure(fit: ScanFit) -> Figure:
    """Draw where the lines lie, their waves magnified, and below each line with the fit over it."""
    result = fit.result
    rows = -(-len(result.lines) // COLUMNS)
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(11.0, 5.2 + 1.15 * rows), layout="constrained")
        figure.suptitle(
            f"{fit.name}: {len(result.lines)} lines, {100 * result.explained:.0f} % of their waves explained",
            x=0.01, ha="left", fontsize=12, fontweight="bold", color=BAND,
        )  # fmt: skip
        parts = figure.add_gridspec(rows + 1, COLUMNS, height_ratios=[4.0, *[1.0] * rows])
        page = figure.add_subplot(parts[0, :])
        most = 1e3 * max(float(np.abs(seen).max()) for seen in result.seen)
        for k, (line, seen, model) in enumerate(zip(result.lines, result.seen, result.fitted, strict=True)):
            for wave, colour, width in ((seen, REFERENCE, 1.6), (model, AFTER, 0.8)):
                page.plot(*line.line.at(line.s_mm, MAGNIFIED * wave).T, color=colour, lw=width)
            panel = figure.add_subplot(parts[1 + k // COLUMNS, k % COLUMNS])
            panel.plot(line.s_mm, 1e3 * seen, color=REFERENCE, lw=1.2)
            panel.plot(line.s_mm, 1e3 * model, color=AFTER, lw=0.9)
            panel.set_ylim(-most, most)
            speed = float(line.stroke.motion.speed[-1])
            panel.set_title(f"{line.stroke.name.removeprefix('ffcomp-')} · {speed:.0f} mm/s", fontsize=6, color=SOFT)
            panel.tick_params(labelsize=6)
            grid(panel)
        page.set_aspect("equal")
        page.set_title(
            f"waves {MAGNIFIED:.0f} times larger, mm; below: µm across over mm along each line; dark as drawn, blue "
            f"the machine · ffcomp {__version__}", fontsize=8, color=SOFT,
        )  # fmt: skip
    return figure
