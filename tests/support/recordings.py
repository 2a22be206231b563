"""Captures of a plan as Klipper writes them, by our own printer: for tests that need files, not a judge."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ffcomp.record.plan import load_plan
from ffcomp.shapers.apply import shape
from ffcomp.shapers.pulses import Shaper
from models.machine import Machine
from models.printer.printer import simulate_printer
from validation.plants.accelerometer import draw_chip, klipper_capture


def write_captures(
    plan: Path,
    plant: Machine,
    folder: Path,
    *,
    kinds: Sequence[str] = (),
    axes: NDArray[np.float64] | None = None,
    noise_m_per_s2: float = 0.15,
    shapers: Sequence[Shaper | None] = (None, None),
) -> list[Path]:
    """Write one capture for each execution of the plan's experiments of these kinds (none: all).

    shapers : of x and y, which the firmware has left on
    """
    moves, rng = load_plan(plan), np.random.default_rng(1)
    chip = draw_chip(rng, np.eye(3) if axes is None else axes)
    object.__setattr__(chip, "noise_m_per_s2", noise_m_per_s2)
    folder.mkdir(exist_ok=True)
    written = []
    for each, repeat in moves.runs():
        if kinds and each.kind not in kinds:
            continue
        t = np.arange(-1.2, each.duration_s + 0.8, 1 / 3200)
        carriages = plant.kinematics.inverse(shape(each.motion.nozzle, t, *shapers))
        felt = CubicSpline(t, simulate_printer(plant, carriages, 1 / 3200).nozzle_acceleration)
        end = each.duration_s + moves.rest_after_s
        path = folder / f"adxl345-{each.name}-{repeat}.csv"
        path.write_text(klipper_capture(felt, chip, -moves.rest_before_s, end, 55.0, rng), encoding="utf-8")
        written.append(path)
    return written
