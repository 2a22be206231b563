"""The problem of whatever a machine file describes: how its recordings are read, checked, and simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ffcomp.diagnosis.axis_problem import AxisProblem
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Problem, Repeats
from ffcomp.errors import MeasurementError, RequestError
from ffcomp.measurement.axis_run import AxisRun, read_axis_run
from ffcomp.measurement.recording import Recording
from ffcomp.record.join import load_recordings
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE
from models.file import load_plant
from models.kinds import driven_axis, is_one_axis
from models.machine import Machine

Recorded = Recording | AxisRun

SAME_COMMAND_MM = 0.01  # a microstep or less: what two repeats may differ by


def plant_of(machine: str | Path | Machine) -> Machine:
    """Load a printer or one axis by itself, unless it is loaded already."""
    return machine if isinstance(machine, Machine) else load_plant(str(machine))


def recordings_of(
    plant: Machine,
    paths: Sequence[str | Path],
    plan: str | Path | None = None,
    turn: FloatArray | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Recorded]:
    """Read the recordings of a printer, captures of a plan included, or the runs of an axis.

    plan, turn, progress : as `ffcomp.record.join.load_recordings` takes them
    """
    if not is_one_axis(plant):
        return with_folders(load_recordings(paths, plant, plan, turn, progress))
    if plan is not None:
        raise RequestError(f"{plant.name} is one axis by itself: there is no plan of moves for it. Leave --plan out.")
    runs = [read_axis_run(path, driven_axis(plant).input) for path in paths]
    for sentence in (each for run in runs for each in run.remarks):
        progress(sentence)
    return with_folders(runs)


def with_folders(recordings: Sequence[Recorded]) -> list[Recorded]:
    """Let files of two folders that share a name be two experiments: only a trailing -1, -2 names a repeat.

    Recordings from before and after a change lie in two folders, and do not repeat each other.
    """
    folders: dict[str, set[Path]] = {}
    for each in recordings:
        folders.setdefault(each.repeat_of, set()).add(Path(each.source).parent)
    return [
        replace(each, folder=str(Path(each.source).parent)) if len(folders[each.repeat_of]) > 1 else each
        for each in recordings
    ]


def problem_of(plant: Machine, recordings: Sequence[Recorded], names: Sequence[str] = tuple(CATALOGUE)) -> Problem:
    """Return the problem of a machine and its recordings; `names` : the effects that are looked for."""
    if is_one_axis(plant):
        return AxisProblem(plant, [each for each in recordings if isinstance(each, AxisRun)], names)
    return PrinterProblem(plant, [each for each in recordings if isinstance(each, Recording)], names)


def check_recordings(problem: Problem, recordings: Sequence[Recorded], without_repeats: bool) -> None:
    """Raise MeasurementError for recordings that no diagnosis can rest on."""
    check_alike(recordings)
    # a measured force is never the same twice, and an encoder shows its noise: such a run needs no repeat
    needless = all(isinstance(each, AxisRun) and each.by_force and each.position for each in recordings)
    if not (without_repeats or needless):
        check_repeats(recordings)
    check_repeating(problem.repeats)


def check_alike(recordings: Sequence[Recorded]) -> None:
    """Raise MeasurementError for recordings that are named as repeats of one experiment, and are none."""
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
    """Raise MeasurementError for recordings without repeats, because the noise would be a guess."""
    lengths: dict[str, dict[str, int]] = {}
    for each in recordings:
        lengths.setdefault(each.repeat_of, {})[Path(each.source).name] = len(each.time_s)
    if any(len(set(rows.values())) < len(rows) for rows in lengths.values()):
        return
    rule = (
        f"None of the {len(recordings)} recordings repeats another, but only repeats show how large the noise is: at "
        "least one experiment must be there twice, in files of the same length whose names differ in a trailing -1, -2 "
        "only."
    )
    if all(isinstance(each, AxisRun) and each.by_force for each in recordings):
        rule += " On an axis driven by a force, an encoder's position shows it too."
    if several := next((rows for rows in lengths.values() if len(rows) > 1), None):
        rows = ", ".join(f"{name} {count}" for name, count in several.items())
        rule += f" These are named as repeats, but differ in length (rows): {rows}. Cut them to the same."
    names = [Path(each.source).name for each in recordings]
    raise MeasurementError(", ".join(names[:3]) + (" …" if len(names) > 3 else ""), [rule])


def check_repeating(repeats: Sequence[Repeats]) -> None:
    """Raise MeasurementError for repeats that differ by more than noise: that is no floor for anything."""
    differing = [each for each in repeats if each.differ]
    if differing:
        raise MeasurementError(differing[0].files[0], [each.trouble() for each in differing])
