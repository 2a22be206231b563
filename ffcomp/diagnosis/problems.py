"""The problem of whatever a machine file describes: how its recordings are read, checked, and simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ffcomp.diagnosis.axis_problem import AxisProblem
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Problem
from ffcomp.diagnosis.validation import Recorded, check_alike, check_repeating, check_repeats
from ffcomp.errors import RequestError
from ffcomp.measurement.axis_run import AxisRun, read_axis_run
from ffcomp.measurement.recording import Recording
from ffcomp.record.join import load_recordings
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE
from models.file import load_plant
from models.kinds import driven_axis, is_one_axis
from models.machine import Machine

ALL = tuple(CATALOGUE)


def plant_of(machine: str | Path | Machine) -> Machine:
    """Load a printer or one axis by itself, unless it is loaded already."""
    return load_plant(str(machine)) if isinstance(machine, str | Path) else machine


def paths_of(files: Sequence[str | Path] | str | Path) -> list[Path]:
    """Return the paths of one file or several."""
    return [Path(files)] if isinstance(files, str | Path) else [Path(file) for file in files]


def recordings_of(
    plant: Machine,
    paths: Sequence[str | Path],
    plan: str | Path | None = None,
    turn: FloatArray | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Recorded]:
    """Read the recordings of a printer, captures of a plan included, or the runs of an axis.

    Parameters
    ----------
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

    What was recorded before and after something was changed lies in two folders, and does not repeat.
    """
    folders: dict[str, set[Path]] = {}
    for each in recordings:
        folders.setdefault(each.repeat_of, set()).add(Path(each.source).parent)
    return [
        replace(each, folder=str(Path(each.source).parent)) if len(folders[each.repeat_of]) > 1 else each
        for each in recordings
    ]


def problem_of(plant: Machine, recordings: Sequence[Recorded], names: Sequence[str] = ALL) -> Problem:
    """Return the problem of a machine and its recordings; `names` : the effects that are looked for."""
    if is_one_axis(plant):
        return AxisProblem(plant, [each for each in recordings if isinstance(each, AxisRun)], names)
    return PrinterProblem(plant, [each for each in recordings if isinstance(each, Recording)], names)


def check_recordings(problem: Problem, recordings: Sequence[Recorded], without_repeats: bool) -> None:
    """Refuse recordings that no diagnosis can rest on.

    Raises
    ------
    MeasurementError
    """
    check_alike(recordings)
    if not (without_repeats or all(_knows_its_noise(each) for each in recordings)):
        check_repeats(recordings)
    check_repeating(problem.repeats)


def _knows_its_noise(recording: Recorded) -> bool:
    """Tell whether a run needs no repeat: a measured force is never the same twice, and an encoder shows its noise."""
    return isinstance(recording, AxisRun) and recording.by_force and bool(recording.position)
