"""Draw accuracy against command acceleration, with the knee that sets a machine's bandwidth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffcomp.inverse.bandwidth import EffortCurve
from ffcomp.report.drawing import (
    AFTER,
    BEYOND,
    RC,
    SOFT,
    band,
    file_of,
    grid,
    layout,
    machine_line,
    plain_decades,
    room_below,
)
from gcode.atomic_write import replace_atomically
from models.machine import Machine

LINES, MARKS = ("-", "--", ":", "-."), ("o", "s", "^", "D")  # all are ffcomp, so all are blue


def draw_effort(curves: Mapping[float, EffortCurve], machine: Machine, path: Path) -> None:
    """Draw one curve for each number of segments a second into `path`, which ends in .png or .svg."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(8.2, 5.6), layout=layout())
        room_below(figure, band(figure, "Accuracy against effort", effort_verdict(curves), machine_line(machine)))
        axes = figure.subplots()
        for number, (rate, curve) in enumerate(curves.items()):
            _curve(axes, rate, curve, number)
        limit = machine.limits.carriage_acceleration_mm_per_s2 / 1e3
        if limit < 2 * axes.get_xlim()[1]:
            axes.axvline(limit, color=BEYOND, linewidth=1.2, label=f"limit of the machine file: {limit:g} m/s²")
        for axis in (axes.xaxis, axes.yaxis):
            plain_decades(axis)
        axes.set_xlabel("peak acceleration of the carriages' command, m/s²")
        axes.set_ylabel("tracking error, µm rms")
        axes.legend(title="circle: the knee, where ffcomp works", frameon=False, alignment="left")
        grid(axes)
        replace_atomically(path, [file_of(figure, "svg" if path.suffix == ".svg" else "png")])


def effort_verdict(curves: Mapping[float, EffortCurve]) -> str:
    """Say in a sentence what the knee of the first curve asks for, and what more would win."""
    rate, curve = next(iter(curves.items()))
    at, knee = curve.peak_mm_per_s2[curve.knee] / 1e3, curve.error_um[curve.knee]
    most, least = curve.peak_mm_per_s2.max() / 1e3, curve.error_um.min()
    at_knee = f"At the knee ({rate:g} segments/s) {at:.1f} m/s² leave {knee:.2g} µm"
    if least > 0.95 * knee:
        return f"{at_knee}; more acceleration wins nothing."
    return f"{at_knee}; up to {most:.0f} m/s² would leave {least:.2g} µm."


def _curve(axes: Axes, rate: float, curve: EffortCurve, number: int) -> None:
    peak, knee = curve.peak_mm_per_s2 / 1e3, curve.knee
    look = {"linestyle": LINES[number % len(LINES)], "marker": MARKS[number % len(MARKS)]}
    label = f"{rate:g} segments/s, bandwidth {curve.knee_hz:.0f} Hz"
    axes.loglog(peak, curve.error_um, color=AFTER, markersize=3.5, linewidth=1.4, label=label, **look)
    axes.loglog(peak[knee], curve.error_um[knee], "o", ms=11, mfc="none", mew=1.8, color=AFTER)
    axes.annotate(
        f"{peak[knee]:.1f} m/s², {curve.error_um[knee]:.2g} µm", (peak[knee], curve.error_um[knee]),
        xytext=(12, 12 + 13 * number), textcoords="offset points", fontsize=8, color=SOFT,
    )  # fmt: skip
