"""A bed slinger of `validation/plants`, its machine file, and captures of its two accelerometers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.record.plan import Plan
from validation.plants.accelerometer import draw_chip, klipper_capture
from validation.plants.straight_plant import Plant, simulate

PLANT_HZ, BEFORE_S, AFTER_S, HEIGHT_MM = 6400.0, 1.2, 0.7, 30.0
TURNED = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # from the printer's axes to the chip's
SLINGER = replace(Plant(middle_m=0.0), carriage_kg=(0.35, 0.9))
# By chip: its axes, and how it feels x, y and z. The bed, which moves along y, runs the other way round.
CHIPS = {"adxl345": (TURNED, (1.0, 0.0, 0.0)), "adxl345-bed": (np.eye(3), (0.0, -1.0, 0.0))}


def machine_text() -> str:
    """Return the printer's machine file."""
    lines = ['format = "ffcomp-machine/1"', 'name = "cartesian"', "[kinematics]", 'type = "cartesian"']
    lines += ["x_range_mm = [-100.0, 100.0]", "y_range_mm = [-100.0, 100.0]", "z_range_mm = [0.0, 250.0]"]
    for axis in range(2):
        (frequency,), (damping,), _ = SLINGER.axis_modes(axis)
        lines += [f"[axes.{'xy'[axis]}]", f"frequency_hz = [{frequency:.6g}]", f"damping_ratio = [{damping:.6g}]"]
        lines += [f"mass_kg = {SLINGER.carriage_kg[axis]}"]
    lines += ["[limits]", "velocity_mm_per_s = 300.0", "acceleration_mm_per_s2 = 5000.0"]
    lines += ["[steps]", "steps_per_mm = 80.0", "full_steps_per_mm = 5.0"]
    return "\n".join([*lines, "[uncertainty]", "default = 0.02"]) + "\n"


def as_captures(folder: Path, moves: Plan) -> list[Path]:
    """Make every execution on the printer and record it with both chips."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng([7, 7])
    chips = {name: (draw_chip(rng, axes), np.array(felt)) for name, (axes, felt) in CHIPS.items()}
    found, clock_s = [], 30.0
    for each, repeat in moves.runs():
        t = np.arange(-BEFORE_S, each.duration_s + AFTER_S, 1 / PLANT_HZ)
        command = each.motion.nozzle(np.clip(t, -0.9, each.duration_s + 0.4))[:, :2]
        moved = simulate(SLINGER, command, PLANT_HZ, HEIGHT_MM)["acceleration_m_per_s2"]
        begin_s, end_s = -moves.rest_before_s, each.duration_s + moves.rest_after_s
        for name, (chip, felt) in chips.items():
            spline = CubicSpline(t, np.column_stack([moved, np.zeros(len(t))]) * felt)
            text = with_lost_rows(klipper_capture(spline, chip, begin_s, end_s, clock_s, rng), rng)
            found.append(folder / f"{name}-{each.name}-{repeat}.csv")
            found[-1].write_text(text, encoding="utf-8")
        clock_s += end_s - begin_s + 2.0
    return found


def with_lost_rows(text: str, rng: np.random.Generator) -> str:
    """Leave out one row in 2000, as a busy host does."""
    head, *rows = text.splitlines(keepends=True)
    stay = rng.uniform(size=len(rows)) > 1 / 2000
    stay[0] = True
    return head + "".join(row for row, kept in zip(rows, stay, strict=True) if kept)
