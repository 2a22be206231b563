"""The verbs `gap` and `diagnose`: files in; the discrepancy, or the verdict and the better machine file out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any, ClassVar, cast

from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.next_experiment import separations
from ffcomp.diagnosis.noise import NoiseFloor, at_least, noise_floor, whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Problem, Repeats
from ffcomp.diagnosis.problems import Recorded, check_alike, check_recordings, plant_of, problem_of, recordings_of
from ffcomp.diagnosis.request import DiagnoseRequest, GapRequest
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.sentences import summary_sentences, what_to_do
from ffcomp.diagnosis.trace import Trace
from ffcomp.diagnosis.where import ResidualBreakdown, locate_residual
from ffcomp.diagnosis.words import percent
from ffcomp.errors import RequestError
from ffcomp.identification.machine_fit import hash_of
from ffcomp.numerics.serialise import keys
from ffcomp.numerics.stages import Progress
from ffcomp.record.axes import turn_of
from ffcomp.result import Fact, Result
from gcode.atomic_write import replace_atomically
from models.file import check_text
from models.machine import Machine


@dataclass(frozen=True, eq=False, repr=False)
class Discrepancy(Result):
    """The model discrepancy of a machine file on some recordings."""

    title = "Simulation against measurement"
    schema = "ffcomp-gap/1"
    page_by = "ffcomp.report.diagnose:gap_page"
    json_keys: ClassVar = keys("compared", "notes", noise_from_repeats="floor.from_repeats") | keys(
        nrms="residual.total.nrms", noise_nrms="residual.total.noise_nrms", where="residual"
    )

    residual: ResidualBreakdown
    floor: NoiseFloor
    notes: tuple[str, ...] = ()  # faults of the repeats, in full sentences
    compared: str = "signals"  # or "forces": the drive's, and those that the measured motion needs

    @property
    def headline(self) -> str:
        """How large the disagreement is, and what noise alone would leave."""
        total, noise = self.residual.total, "; that is noise" if self.is_noise else ""
        compared = "the drive's forces" if self.compared == "forces" else "the signals"
        return (
            f"Simulation and measurement differ by {100 * total.nrms:.2f} % of {compared}; noise alone would leave "
            f"{100 * total.noise_nrms:.2f} % (known from {self.floor.origin}){noise}."
        )

    @property
    def is_noise(self) -> bool:
        """Whether there is nothing else."""
        return self.residual.total.over_noise < 1.1 and not self.notes

    @property
    def facts(self) -> list[Fact]:
        """The disagreement by signal and run, and where most of it is."""
        sizes = [*self.residual.signals.items(), *self.residual.recordings.items()]
        facts = [(name, f"{100 * e.nrms:.2f} %, {e.over_noise:.1f} times the noise") for name, e in sizes]
        return facts if self.is_noise else [*facts, *self.residual.facts]

    @property
    def warnings(self) -> Sequence[str]:
        """The faults of the repeats."""
        return self.notes


def gap_request(request: GapRequest) -> Discrepancy:
    """Measure where and how much recordings and simulation disagree.

    Raises
    ------
    MeasurementError, MachineFileError

    Examples
    --------
    >>> ffcomp.gap(["run-1.csv", "run-2.csv"], "mp-delta-pro").headline
    """
    plant = plant_of(request.machine)
    given = cast("tuple[object, ...]", request.recordings)
    recordings = [each for each in given if isinstance(each, Recorded)]
    files = [each for each in given if isinstance(each, Path)]
    if len(recordings) + len(files) < len(given):
        raise RequestError("recordings: each must be the path of a file, or a recording that has been read.")
    if files:
        recordings += recordings_of(plant, files, request.plan, turn_of(request.axes_map), request.progress)
    return measure_gap(plant, recordings)


def measure_gap(machine: Machine, recordings: Sequence[Recorded]) -> Discrepancy:
    """Simulate the recordings with the machine and its effects, and compare; MeasurementError if they cannot be its."""
    problem = problem_of(machine, recordings, ())
    check_alike(recordings)
    return gap_of(problem.compared())


def gap_of(problem: Problem) -> Discrepancy:
    """Compare a problem's observations with its simulation by the machine file."""
    simulated = problem.simulate({})
    floor = noise_floor(problem, simulated)
    if problem.forces:  # one that a command repeats shows nothing of the noise of the motion
        floor = at_least(floor, problem.observations, problem.band_hz, problem.least_density)
    whiten = whitener(problem.observations, floor, problem.band_hz)
    residual = locate_residual(problem, whiten, floor, simulated)
    return Discrepancy(residual, floor, tuple(_notes(problem.repeats)), "forces" if problem.forces else "signals")


def _notes(repeats: Sequence[Repeats]) -> list[str]:
    late = [f"{each.late()}; they were aligned before they were compared." for each in repeats if each.apart]
    return [*late, *(each.trouble() for each in repeats if each.differ)]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Diagnosis(DiagnosisResult, Result):
    """The effects that a machine file lacks, if any."""

    schema = "ffcomp-diagnose/1"
    json_keys: ClassVar = keys("said", "seconds", to_do="next_steps", machine="output") | DiagnosisResult.json_keys
    page_by = "ffcomp.report.diagnose:page_of"

    runs: Sequence[Path] = ()  # the files of the recordings
    output: Path | None = None  # the improved machine file; None: not written
    seconds: float = 0.0  # of computing

    @property
    def said(self) -> list[str]:
        """The answer in sentences."""
        return summary_sentences(self)

    @property
    def headline(self) -> str:
        """The finding."""
        return self.said[0]

    @property
    def facts(self) -> list[Fact]:
        """The effects' parameters, the gap before and after, and what was written."""
        gap = self.gap
        facts = [
            (f"{name}.{key}", f"{_digits(e.value)} (90 %: {_digits(e.low)} to {_digits(e.high)})")
            for name in self.named
            for key, e in self.parameters(name).items()
        ]
        left = f"{percent(gap.before)} → {percent(gap.after)}; noise alone {percent(gap.noise)}"
        facts.append(("Disagreement", left))
        facts += [("Not explained", curve.sentence) for curve in self.curves[:1]]
        if self.dominant is not None:
            facts += self.dominant.left.facts
        return facts if self.output is None else [*facts, ("Better file", str(self.output))]

    @property
    def warnings(self) -> list[str]:
        """The basis of the finding, and its limits."""
        hidden = self.search.invisible
        alike = [f"Looks alike: {each.name}. To separate them: {each.separate_by}" for each in self.confounded_with]
        unseen = [f"These runs could not show: {', '.join(hidden)}."] if hidden else []
        return [*self.said[1:], *(alike if self.named else ()), *unseen]

    @property
    def next_steps(self) -> list[str]:
        """What to do to the printer, to its file, and what to record next."""
        return what_to_do(self)

    def file_text(self) -> str:
        """Return the text of the improved machine file."""
        assert self.output is not None
        text = self.better_file(self.output.stem, [hash_of(path) for path in self.runs])
        check_text(text, str(self.output))
        return text


def _digits(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_digits(x) for x in value)}]"
    return value if isinstance(value, str) else f"{value:.4g}"


def diagnose_request(request: DiagnoseRequest, search_progress: Progress | None = None) -> Diagnosis:
    """Find the physical effect that a machine file lacks, and its size.

    The improved machine file is written only if an effect is named or retuning closes the discrepancy. The search may
    have a progress of its own.

    Raises
    ------
    MeasurementError, MachineFileError

    Examples
    --------
    >>> ffcomp.diagnose(["a-1.csv", "a-2.csv"], "my.toml", "better.toml")
    """
    began, plant, runs = time.monotonic(), plant_of(request.machine), cast("tuple[Path, ...]", request.recordings)
    recordings = recordings_of(plant, runs, request.plan, turn_of(request.axes_map), request.progress)
    problem = problem_of(plant, recordings)
    check_recordings(problem, recordings, request.without_repeats)
    trace, budget = Trace(), inf if request.thorough else None
    search = diagnose(problem, search_progress or request.progress, budget, request.settings, trace)
    if request.trace is not None:
        trace.write(request.trace)
    diagnosis = Diagnosis(search=search, runs=runs)
    if isinstance(problem := diagnosis.problem, PrinterProblem):  # one axis takes no G-code
        diagnosis = replace(diagnosis, separations=separations(problem, search))
    output = Path(request.output) if request.output is not None and diagnosis.mends else None
    diagnosis = replace(diagnosis, output=output, seconds=time.monotonic() - began)
    if output is not None:
        replace_atomically(output, [diagnosis.file_text().encode()])
    return diagnosis
