"""The problem of whatever a machine file describes: how its recordings are read, checked, and simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import singledispatch
from pathlib import Path

from ffcomp.diagnose.axis_problem import AxisProblem
from ffcomp.diagnose.diagnosis import Diagnosis
from ffcomp.diagnose.next_experiment import Proposal, propose
from ffcomp.diagnose.print_gain import PrintGain, print_gain
from ffcomp.diagnose.printer_problem import PrinterProblem
from ffcomp.diagnose.problem import Problem
from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.diagnose.separating_moves import separations
from ffcomp.diagnose.validation import Recorded, check_alike, check_repeating, check_repeats
from ffcomp.errors import RequestError
from ffcomp.measurement.axis_run import AxisRun, read_axis_run
from ffcomp.measurement.recording import Recording
from ffcomp.record.join import load_recordings
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE
from models.kinds import is_one_axis
from models.machine import Machine

ALL = tuple(CATALOGUE)


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
        return told_apart(load_recordings(paths, plant, plan, turn, progress))
    if plan is not None:
        raise RequestError(f"{plant.name} is one axis by itself: there is no plan of moves for it. Leave --plan out.")
    return told_apart([read_axis_run(path) for path in paths])


def told_apart(recordings: Sequence[Recorded]) -> list[Recorded]:
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
    if not (without_repeats or all(_tells_its_noise(each) for each in recordings)):
        check_repeats(recordings)
    check_repeating(problem.repeats)


def _tells_its_noise(recording: Recorded) -> bool:
    """Tell whether a run needs no repeat: a measured force is never the same twice, and an encoder tells its noise."""
    return isinstance(recording, AxisRun) and recording.by_force and bool(recording.position)


@singledispatch
def proposals_of(problem: Problem, found: Diagnosis) -> list[Proposal]:
    """Propose the moves that tell competing hypotheses apart; of an axis none, for it takes no G-code."""
    del problem, found
    return []


@proposals_of.register
def _(problem: PrinterProblem, found: Diagnosis) -> list[Proposal]:
    return propose(problem, found)


@singledispatch
def separated(problem: Problem, found: Diagnosis, told: DiagnosisResult) -> DiagnosisResult:
    """Add what to record where several explanations fit equally; of an axis nothing, for it takes no G-code."""
    del problem, found
    return told


@separated.register
def _(problem: PrinterProblem, found: Diagnosis, told: DiagnosisResult) -> DiagnosisResult:
    return replace(told, separations=separations(problem, found))


def gain_of(plant: Machine, found: DiagnosisResult) -> PrintGain | None:
    """Predict what prints gain; an axis prints nothing."""
    return None if is_one_axis(plant) else print_gain(plant, found)
