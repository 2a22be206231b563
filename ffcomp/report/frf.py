"""Pictures of the model: Bode figures of the carriages, and the modes over the bed."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")
from matplotlib.figure import Figure

from models.machine import Machine
from models.receptance import carriage_frf, modes

FloatArray = NDArray[np.float64]

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222")
MAP_PITCH_MM = 6.0
OVERDAMPED = 0.5  # modes damped more than this do not ring, and are not drawn


def _title(machine: Machine) -> str:
    return f"{machine.name} · machine file sha256 {machine.sha256[:8]} · load map: {machine.effector.force_map}"


def draw_bode(machine: Machine, places: list[FloatArray], frequencies: FloatArray, target: Path) -> None:
    """Magnitude and phase of A to A, B to B and C to C at the places, as in the paper's Figs. 11-13."""
    figure = Figure(figsize=(15, 7.5), layout="constrained")
    figure.suptitle(f"Commanded to real carriage position\n{_title(machine)}", x=0.01, ha="left")
    axes = figure.subplots(2, 3, sharex=True, sharey="row")
    for place, colour in zip(places, COLOURS * len(places), strict=False):
        g = carriage_frf(machine, place, frequencies)
        for tower in range(3):
            own = g[:, tower, tower]
            label = f"({place[0]:g}, {place[1]:g}) mm"
            axes[0, tower].semilogy(frequencies, np.abs(own), color=colour, label=label)
            axes[1, tower].plot(frequencies, np.degrees(np.unwrap(np.angle(own))), color=colour)
    for tower, name in enumerate("ABC"):
        axes[0, tower].set(title=f"{name} to {name}")
        axes[1, tower].set(xlabel="frequency, Hz")
        for room in axes[:, tower]:
            room.grid(alpha=0.3)
    axes[0, 0].set(ylabel="magnitude, mm/mm")
    axes[1, 0].set(ylabel="phase, °")
    axes[0, 2].legend(title="nozzle at", loc="upper right")
    figure.savefig(target, dpi=110)


def draw_map(machine: Machine, target: Path) -> None:
    """Frequency (colour) and damping (lines) of every mode that rings, over the bed."""
    x, places = _grid(machine)
    frequency, damping = _modes_over(machine, places, len(x))
    count = frequency.shape[2]
    figure = Figure(figsize=(4.6 * count, 5.4), layout="constrained")
    span = [f"{np.nanmin(f):.0f}-{np.nanmax(f):.0f}" for f in np.moveaxis(frequency, 2, 0)]
    figure.suptitle(f"Modes over the bed: {', '.join(span)} Hz\n{_title(machine)}", x=0.01, ha="left")
    for mode, axes in enumerate(figure.subplots(1, count, squeeze=False)[0]):
        colours = axes.contourf(x, x, frequency[:, :, mode].T, levels=24, cmap="viridis")
        figure.colorbar(colours, ax=axes, label="Hz", location="bottom")
        lines = axes.contour(x, x, 100 * damping[:, :, mode].T, levels=5, colors="white", linewidths=0.7)
        axes.clabel(lines, fmt="%.1f %%", fontsize=7)
        towers = machine.kinematics.towers_mm
        reach = 1.08 * machine.kinematics.print_radius_mm
        for name, tower in zip("ABC", towers, strict=True):
            axes.text(*(tower / np.hypot(*tower) * reach), name, ha="center", va="center", weight="bold")
        axes.set(aspect="equal", title=f"mode {mode + 1}", xlabel="X, mm", xlim=(-1.15 * reach, 1.15 * reach))
        axes.set(ylim=(-1.15 * reach, 1.15 * reach))
    figure.savefig(target, dpi=110)


def _grid(machine: Machine) -> tuple[FloatArray, FloatArray]:
    """Axis (k,) mm, and the places (k, k, 2) mm of the square round the bed."""
    reach = machine.kinematics.print_radius_mm
    x = np.linspace(-reach, reach, 2 * int(np.ceil(reach / MAP_PITCH_MM)) + 1)
    return x, np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1)


def _modes_over(machine: Machine, places: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies (Hz) and damping ratios of the modes that ring at the centre, (k, k, m); NaN outside the bed."""
    centre = modes(machine, np.zeros(2))
    rings = np.flatnonzero(centre.damping_ratios < OVERDAMPED)
    frequency = np.full((k, k, len(rings)), np.nan)
    damping = frequency.copy()
    for i, j in np.argwhere(np.hypot(*np.moveaxis(places, 2, 0)) <= machine.kinematics.print_radius_mm + 1e-9):
        found = modes(machine, places[i, j])
        if len(found.frequencies_hz) == len(centre.frequencies_hz):
            frequency[i, j], damping[i, j] = found.frequencies_hz[rings], found.damping_ratios[rings]
    return frequency, damping
