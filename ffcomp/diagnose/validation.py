"""What runs must be, beyond being readable, before a diagnosis can rest on them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.orientation import misplaced
from ffcomp.measurement.recording import Run
from ffcomp.measurement.sensors import command_unit
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.machine import Machine

ROOM_MM = 25.0  # around the print volume, in which a nozzle may still be commanded
SAME_COMMAND_MM = 0.01  # a microstep or less: what two repeats may differ by


def carriages_of(machine: Machine, run: Run) -> FloatArray:
    """(n, 3) mm: what the motors were told. A nozzle command goes through the file's kinematics, as in firmware.

    Raises
    ------
    MeasurementError
        If this machine cannot have been told so, or the sensors of the run move otherwise than they are named.
    """
    try:
        carriages = run.command if run.command_space == "carriage" else machine.kinematics.inverse(run.command)
        nozzle = machine.kinematics.forward(carriages)
        problem = _outside(machine, run, nozzle)
    except UnreachableError as error:
        problem = f"{error} {_another(machine)}"
    if problem:
        raise MeasurementError(run.source, command_unit(run.command, run.inputs) or [problem])
    problems = misplaced({**run.acceleration, **run.position}, _expected(carriages, nozzle, run), run.sample_rate_hz)
    if problems:
        raise MeasurementError(run.source, problems)
    return carriages


def _expected(carriages: FloatArray, nozzle: FloatArray, run: Run) -> dict[str, FloatArray]:
    """What every sensor would feel if the printer followed its command exactly; m/s² and mm."""
    moving = dict(zip("ABCxyz", np.hstack([carriages, nozzle]).T, strict=True))
    felt = {f"acc_{axis}": np.pad(np.diff(x * 1e-3, 2) * run.sample_rate_hz**2, 1) for axis, x in moving.items()}
    return felt | {f"pos_{axis}": x for axis, x in moving.items()}


def _outside(machine: Machine, run: Run, nozzle: FloatArray) -> str:
    """Where the nozzle leaves the print volume, as a sentence; '' if nowhere."""
    geometry = machine.delta
    beyond = np.hypot(nozzle[:, 0], nozzle[:, 1]) > geometry.print_radius_mm + ROOM_MM
    beyond |= (nozzle[:, 2] < -ROOM_MM) | (nozzle[:, 2] > geometry.print_height_mm + ROOM_MM)
    if not beyond.any():
        return ""
    i = int(np.argmax(beyond))
    x, y, z = nozzle[i]
    return (
        f"{run.time_s[i] - run.time_s[0]:.4g} s after the beginning the command means a nozzle at "
        f"({x:.0f}, {y:.0f}, {z:.0f}) mm; the print volume of {machine.name} has a radius of "
        f"{geometry.print_radius_mm:g} mm and a height of {geometry.print_height_mm:g} mm. {_another(machine)}"
    )


def _another(machine: Machine) -> str:
    return f"Was the run made on another machine than {machine.name}, or does its file hold another geometry?"


def check_alike(runs: Sequence[Run]) -> None:
    """Refuse runs that are named as repeats of one experiment, and are none.

    Raises
    ------
    MeasurementError
    """
    firsts: dict[str, Run] = {}
    for run in runs:
        first = firsts.setdefault(run.repeat_of, run)
        problem = _other_sensors(first, run) or _another_command(first, run)
        if problem:
            said = f"By its name it repeats {Path(first.source).name}, but"
            raise MeasurementError(run.source, [f"{said} {problem}"])


def _other_sensors(first: Run, run: Run) -> str:
    sensors = [{*one.acceleration, *one.position} for one in (first, run)]
    if sensors[0] == sensors[1]:
        return ""
    only = ", ".join(sorted(sensors[0] ^ sensors[1]))
    return f"only one of the two has {only}; repeats have the same sensors. Leave the column out of both, or of none."


def _another_command(first: Run, run: Run) -> str:
    if first.command_space != run.command_space:
        return "one command is of the carriages, the other of the nozzle; repeats have the same command."
    rows = min(len(first.time_s), len(run.time_s))
    apart = np.abs(first.command[:rows] - run.command[:rows]).max(axis=1)
    if apart.max() <= SAME_COMMAND_MM:
        return ""
    after = float(first.time_s[int(apart.argmax())] - first.time_s[0])
    return (
        f"{after:.4g} s after the beginning the commands are {apart.max():.3g} mm apart; repeats have the same command."
        " Give another experiment another name."
    )


def check_repeats(runs: Sequence[Run]) -> None:
    """Refuse runs of which none was made twice, for what noise can do would be a guess; or whose repeats are none.

    Raises
    ------
    MeasurementError
    """
    check_alike(runs)
    kinds = [(run.repeat_of, len(run.time_s)) for run in runs]
    if any(kinds.count(kind) > 1 for kind in kinds):
        return
    named = ", ".join(Path(run.source).name for run in runs[:3]) + (" …" if len(runs) > 3 else "")
    rule = (
        f"None of the {len(runs)} runs repeats another, but only repeats tell how large the noise is: at least one "
        "experiment must be there twice, in files of the same length whose names differ in a trailing -1, -2 only."
    )
    raise MeasurementError(named, [rule + _lengths(runs)])


def _lengths(runs: Sequence[Run]) -> str:
    """What repeats by name have for lengths, as a sentence; '' if there are none."""
    for run in runs:
        alike = [other for other in runs if other.repeat_of == run.repeat_of]
        if len(alike) > 1:
            rows = ", ".join(f"{Path(other.source).name} {len(other.time_s)}" for other in alike)
            return f" These are named as repeats, and have other numbers of rows: {rows}. Cut them to the same."
    return ""
