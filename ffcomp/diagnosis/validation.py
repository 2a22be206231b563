"""Checks of recordings, beyond being readable, before a diagnosis can rest on them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffcomp.diagnosis.problem import Repeats
from ffcomp.errors import MeasurementError
from ffcomp.measurement.axis_run import AxisRun
from ffcomp.measurement.recording import Recording
from ffcomp.measurement.sensors import command_unit, misplaced, wrong_scale
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.machine import Machine

MARGIN_MM = 25.0  # around the print volume, in which a nozzle may still be commanded
SAME_COMMAND_MM = 0.01  # a microstep or less: what two repeats may differ by


Recorded = Recording | AxisRun


def carriages_of(machine: Machine, recording: Recording) -> FloatArray:
    """Return the carriages' command, (n, 3) mm; a nozzle command goes through the file's kinematics, as in firmware.

    Raises
    ------
    MeasurementError
        If this machine cannot execute the command, or the sensors move otherwise than they are named.
    """
    try:
        carriages = (
            recording.command
            if recording.command_space == "carriage"
            else machine.kinematics.inverse(recording.command)
        )
        nozzle = machine.kinematics.forward(carriages)
        problem = _outside(machine, recording, nozzle)
    except UnreachableError as error:
        problem = f"{error} {_another(machine)}"
    if problem:
        raise MeasurementError(recording.source, command_unit(recording.command, recording.inputs) or [problem])
    problems = misplaced(
        {**recording.acceleration, **recording.position},
        _expected(carriages, nozzle, recording),
        recording.sample_rate_hz,
    )
    problems = _wrong_nozzle_scale(recording, nozzle) or problems
    if problems:
        raise MeasurementError(recording.source, problems)
    return carriages


def _wrong_nozzle_scale(recording: Recording, nozzle: FloatArray) -> list[str]:
    """Check the nozzle's sensors against its path, which only a machine knows where carriages are commanded."""
    if recording.command_space == "nozzle":
        return []  # the reader has done it
    nozzle_signals = {name: x for name, x in recording.acceleration.items() if name[-1] in "xyz"}
    return wrong_scale(nozzle, ("cmd_x", "cmd_y", "cmd_z"), nozzle_signals, recording.sample_rate_hz)


def _expected(carriages: FloatArray, nozzle: FloatArray, recording: Recording) -> dict[str, FloatArray]:
    """Compute every sensor signal of a printer that follows its command exactly; m/s² and mm."""
    moving = dict(zip("ABCxyz", np.hstack([carriages, nozzle]).T, strict=True))
    accelerations = {
        f"acc_{axis}": np.pad(np.diff(x * 1e-3, 2) * recording.sample_rate_hz**2, 1) for axis, x in moving.items()
    }
    return accelerations | {f"pos_{axis}": x for axis, x in moving.items()}


def _outside(machine: Machine, recording: Recording, nozzle: FloatArray) -> str:
    """Say where the nozzle leaves the print volume, in a sentence; '' if nowhere."""
    beyond = ~machine.kinematics.contains(nozzle, MARGIN_MM)
    if not beyond.any():
        return ""
    i = int(np.argmax(beyond))
    x, y, z = nozzle[i]
    return (
        f"{recording.time_s[i] - recording.time_s[0]:.4g} s after the beginning the command means a nozzle at "
        f"({x:.0f}, {y:.0f}, {z:.0f}) mm; the print volume of {machine.name} "
        f"{machine.kinematics.volume_text()}. {_another(machine)}"
    )


def _another(machine: Machine) -> str:
    return f"Was the recording made on another machine than {machine.name}, or does its file hold another geometry?"


def check_alike(recordings: Sequence[Recorded]) -> None:
    """Refuse recordings that are named as repeats of one experiment, and are none.

    Raises
    ------
    MeasurementError
    """
    firsts: dict[str, Recorded] = {}
    for recording in recordings:
        first = firsts.setdefault(recording.repeat_of, recording)
        problem = _other_sensors(first, recording) or _another_command(first, recording)
        if problem:
            raise MeasurementError(
                recording.source, [f"By its name it repeats {Path(first.source).name}, but {problem}"]
            )


def _other_sensors(first: Recorded, recording: Recorded) -> str:
    sensors = [{*one.acceleration, *one.position} for one in (first, recording)]
    if sensors[0] == sensors[1]:
        return ""
    only = ", ".join(sorted(sensors[0] ^ sensors[1]))
    return f"only one of the two has {only}; repeats have the same sensors. Leave the column out of both, or of none."


def _another_command(first: Recorded, recording: Recorded) -> str:
    if first.command_space != recording.command_space:
        return "one command is of the carriages, the other of the nozzle; repeats have the same command."
    rows = min(len(first.time_s), len(recording.time_s))
    apart = np.abs(first.command[:rows] - recording.command[:rows]).max(axis=1)
    if apart.max() <= SAME_COMMAND_MM:
        return ""
    after = float(first.time_s[int(apart.argmax())] - first.time_s[0])
    return (
        f"{after:.4g} s after the beginning the commands are {apart.max():.3g} mm apart; repeats have the same command."
        " Give another experiment another name."
    )


def check_repeats(recordings: Sequence[Recorded]) -> None:
    """Refuse recordings without repeats, for the noise would be a guess, and repeats that are none.

    Raises
    ------
    MeasurementError
    """
    check_alike(recordings)
    kinds = [(recording.repeat_of, len(recording.time_s)) for recording in recordings]
    if any(kinds.count(kind) > 1 for kind in kinds):
        return
    named = ", ".join(Path(recording.source).name for recording in recordings[:3]) + (
        " …" if len(recordings) > 3 else ""
    )
    rule = (
        f"None of the {len(recordings)} recordings repeats another, but only repeats tell how large the noise is: at "
        "least one experiment must be there twice, in files of the same length whose names differ in a trailing -1, -2 "
        "only."
    )
    raise MeasurementError(named, [rule + _lengths(recordings)])


def check_repeating(repeats: Sequence[Repeats]) -> None:
    """Refuse repeats that differ by more than noise: what they differ by is no floor for anything.

    Raises
    ------
    MeasurementError
    """
    differing = [each for each in repeats if each.differ]
    if differing:
        raise MeasurementError(differing[0].files[0], [each.trouble() for each in differing])


def _lengths(recordings: Sequence[Recorded]) -> str:
    """Say which lengths the repeats by name have, in a sentence; '' if there are none."""
    for recording in recordings:
        repeats = [other for other in recordings if other.repeat_of == recording.repeat_of]
        if len(repeats) > 1:
            rows = ", ".join(f"{Path(other.source).name} {len(other.time_s)}" for other in repeats)
            return f" These are named as repeats, but differ in length (rows): {rows}. Cut them to the same."
    return ""
