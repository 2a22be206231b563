"""Figure of a simulation: the worst position close up, and the contour error along the time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffcomp.report.shared.style import AFTER, REFERENCE
from ffcomp.simulate.simulation import SimulationResult
from ffcomp.version import __version__

CLOSE_UP_MM = 2.5  # half the width of the close-up
LEAST_UM = 0.01  # smaller errors are drawn as this


def simulation_figure(result: SimulationResult) -> Figure:
    """Draw the reference and the nozzle's path where the contour error is largest, and the error along the time."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    track = result.track
    figure.suptitle(
        f"{result.plant.name}: contour error {track.contour_rms_um:.2f} µm rms, 99 % below "
        f"{track.contour_p99_um:.1f} µm, largest {track.contour_max_um:.0f} µm",
        x=0.01,
        ha="left",
    )
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.7))
    _close_up(left, result)
    right.semilogy(result.time_s, np.maximum(result.error_um, LEAST_UM), color=AFTER, linewidth=0.6)
    right.set(xlabel="time, s", ylabel="contour error, µm", title="Along the time")
    right.grid(alpha=0.3)
    figure.supxlabel(f"ffcomp v{__version__}", fontsize=7, x=0.99, ha="right")
    return figure


def _close_up(axes: Axes, result: SimulationResult) -> None:
    worst = int(np.argmax(result.error_um))
    centre = result.reference_mm[worst]
    away = np.abs(result.reference_mm - centre)
    near = (away[:, 2] < 0.15) & (away[:, :2].max(axis=1) < 2 * CLOSE_UP_MM)
    for points, colour, label in (
        (result.nozzle_mm, AFTER, "nozzle"),
        (result.reference_mm, REFERENCE, "reference"),
    ):
        shown = np.where(near[:, None], points[:, :2], np.nan)
        axes.plot(shown[:, 0], shown[:, 1], color=colour, linewidth=1.0, label=label)
    axes.set(
        xlim=(centre[0] - CLOSE_UP_MM, centre[0] + CLOSE_UP_MM),
        ylim=(centre[1] - CLOSE_UP_MM, centre[1] + CLOSE_UP_MM),
        xlabel="X, mm",
        ylabel="Y, mm",
        aspect="equal",
        title=f"Largest error, at {result.time_s[worst]:.2f} s",
    )
    axes.legend(frameon=False, loc="best")
