"""Play a motion on a hidden delta."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from validation.blind.delta.equations import rest, run
from validation.blind.delta.numbers import FloatArray, carriages_of, printer_of
from validation.blind.printer.motions import Motion, points
from validation.blind.printer.real import Reading, Real

STEP_S = 1 / 12800
KEPT_EVERY = 2  # 6400 samples a second: what a sensor's clock then picks from
COARSE_STEP_S = 1 / 3200  # for derivatives of a printer without friction or play


def played(real: Real, firmware: Mapping[str, Any], motion: Motion, step_s: float = STEP_S) -> Reading:
    """Return what the printer's sensors say of a motion, before their noise; 6400 samples a second, or one a step."""
    p = printer_of(real.machine, real.fields)
    path = points(motion, 2 / step_s)
    command = carriages_of(firmware, path)
    for order in real.orders:
        command = order(step_s / 2 * np.arange(len(command), dtype=np.float64), command)
    command = np.ascontiguousarray(command / 1e3)
    start = rest(path[0] / 1e3, command[0], p)
    every = KEPT_EVERY if step_s == STEP_S else 1
    out = run(command, _speed(command, step_s / 2), step_s, every, start, p)
    if not np.all(np.isfinite(out)):
        raise ValueError(f"The printer has come apart in the motion {motion.name}.")
    t = step_s * every * np.arange(len(out), dtype=np.float64)
    reading = Reading(t, out[:, 2], out[:, 3], out[:, 0] * 1e3, out[:, 1] * 1e3)
    for reader in real.readers:
        reading = reader(reading)
    return reading


def _speed(command: FloatArray, dt: float) -> FloatArray:
    """Central differences over five rows, fourth order; the ends rest."""
    speed = np.zeros_like(command)
    speed[2:-2] = (8 * (command[3:-1] - command[1:-3]) - (command[4:] - command[:-4])) / (12 * dt)
    return speed
