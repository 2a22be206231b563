"""What runs must be, beyond being readable, before a diagnosis can rest on them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measured.frf import FloatArray
from ffcomp.measured.run import Run
from models.errors import UnreachableError
from models.kinematics.delta import forward, inverse
from models.machine import Machine

ROOM_MM = 25.0  # around the print volume, in which a nozzle may still be commanded


def carriages_of(machine: Machine, run: Run) -> FloatArray:
    """(n, 3) mm: what the motors were told. A nozzle command goes through the file's kinematics, as in firmware.

    Raises
    ------
    MeasurementError
        If this machine cannot have been told so.
    """
    try:
        carriages = run.command if run.command_space == "carriage" else inverse(machine.kinematics, run.command)
        nozzle = forward(machine.kinematics, carriages)
    except UnreachableError as error:
        raise MeasurementError(run.source, [f"{error} {_another(machine)}"]) from error
    problem = _outside(machine, run, nozzle)
    if problem:
        raise MeasurementError(run.source, [problem])
    return carriages


def _outside(machine: Machine, run: Run, nozzle: FloatArray) -> str:
    """Where the nozzle leaves the print volume, as a sentence; '' if nowhere."""
    geometry = machine.kinematics
    beyond = np.hypot(nozzle[:, 0], nozzle[:, 1]) > geometry.print_radius_mm + ROOM_MM
    beyond |= (nozzle[:, 2] < -ROOM_MM) | (nozzle[:, 2] > geometry.print_height_mm + ROOM_MM)
    if not beyond.any():
        return ""
    i = int(np.argmax(beyond))
    x, y, z = nozzle[i]
    return (
        f"At t = {run.time_s[i]:.4g} s the command means a nozzle at ({x:.0f}, {y:.0f}, {z:.0f}) mm; the print volume "
        f"of {machine.name} has a radius of {geometry.print_radius_mm:g} mm and a height of "
        f"{geometry.print_height_mm:g} mm. {_another(machine)}"
    )


def _another(machine: Machine) -> str:
    return f"Was the run made on another machine than {machine.name}, or does its file hold another geometry?"


def check_repeats(runs: Sequence[Run]) -> None:
    """Refuse runs of which none was made twice: what noise can do would be a guess.

    Raises
    ------
    MeasurementError
    """
    kinds = [(run.repeat_of, len(run.time_s)) for run in runs]
    if any(kinds.count(kind) > 1 for kind in kinds):
        return
    named = ", ".join(Path(run.source).name for run in runs[:3]) + (" …" if len(runs) > 3 else "")
    raise MeasurementError(
        named,
        [
            f"None of the {len(runs)} runs repeats another, but only repeats tell how large the noise is: at least one "
            "experiment must be there twice, in files of the same length whose names differ in a trailing -1, -2 only."
        ],
    )
