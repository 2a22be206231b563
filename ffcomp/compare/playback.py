"""Motions through virtual printers: the nozzle that comes of a command, on one plant or on many at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ffcomp.simulate.command import peaks as command_peaks
from ffcomp.simulate.motion import Motion
from models.arrays import FloatArray
from models.machine import Machine
from models.printer.printer import PrinterState, simulate_printer
from models.printer.static_deflection import sag

STEP_S = 1 / 6400  # from row to row of the command, straight between them: 0.03 µm at 10 m/s²
KEEP_EVERY = 4  # rows between two samples that are judged
CHUNK_ROWS = 64_000
JOBS = os.cpu_count() or 1


def play(
    plants: Sequence[Machine], motion: Motion, believed: Machine, progress: Callable[[float], None] = lambda s: None
) -> tuple[FloatArray, list[FloatArray]]:
    """The nozzle of every plant under one command, from rest.

    The command reaches the carriages through the inverse kinematics that the firmware believes in. What the weight
    bends is taken out, as a calibrated printer's bed levelling does it.

    Parameters
    ----------
    progress : called with the print-seconds (times plants) of every chunk that is done

    Returns
    -------
    t : (m,) s;  nozzle : one (m, 3) mm a plant
    """
    delta = believed.kinematics.compiled()
    rows = int((motion.end_t - motion.begin_t) / STEP_S) // KEEP_EVERY * KEEP_EVERY
    states: list[PrinterState | None] = [None] * len(plants)
    found: list[list[FloatArray]] = [[] for _ in plants]

    def advance(i: int) -> None:
        done = simulate_printer(plants[i], command, STEP_S, start=states[i], hold="linear")
        states[i] = done.state
        found[i].append(done.nozzle_mm[KEEP_EVERY::KEEP_EVERY])
        progress((len(command) - 1) * STEP_S)

    with ThreadPoolExecutor(min(JOBS, len(plants))) as pool:
        for first in range(0, rows, CHUNK_ROWS):
            count = min(CHUNK_ROWS, rows - first)
            t = motion.begin_t + STEP_S * np.arange(first, first + count + 1, dtype=np.float64)
            command = delta.inverse(np.ascontiguousarray(motion.position(t)))
            list(pool.map(advance, range(len(plants))))
    t = motion.begin_t + KEEP_EVERY * STEP_S * np.arange(1, rows // KEEP_EVERY + 1, dtype=np.float64)
    whole = [np.concatenate(parts) for parts in found]
    return t, [nozzle - sag(plant, nozzle) for plant, nozzle in zip(plants, whole, strict=True)]


def peaks(motion: Motion, believed: Machine) -> tuple[float, float]:
    """The largest speed, mm/s, and acceleration, mm/s², that any carriage is asked for, over one segment's time."""
    delta = believed.kinematics.compiled()

    def carriages(t: FloatArray) -> FloatArray:
        return delta.inverse(np.ascontiguousarray(motion.position(t)))

    return command_peaks(carriages, motion.begin_t, motion.end_t)
