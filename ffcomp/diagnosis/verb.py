"""The verb `diagnose`: files in; the verdict, what to record next, and the better machine file out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any, ClassVar, cast

from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.next_experiment import separations
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problems import check_recordings, plant_of, problem_of, recordings_of
from ffcomp.diagnosis.request import DiagnoseRequest
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.sentences import summary_sentences, what_to_do
from ffcomp.diagnosis.trace import Trace
from ffcomp.diagnosis.words import percent
from ffcomp.identification.machine_fit import hash_of
from ffcomp.numerics.serialise import keys
from ffcomp.numerics.stages import Progress
from ffcomp.record.axes import turn_of
from ffcomp.result import Fact, Result
from gcode.atomic_write import replace_atomically
from models.file import check_text


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Diagnosis(DiagnosisResult, Result):
    """The effects that a machine file lacks, if any.

    Attributes
    ----------
    runs : the files of the recordings
    output : the improved machine file; None: not written
    seconds : computing took
    """

    schema = "ffcomp-diagnose/1"
    json_keys: ClassVar = keys("said", "seconds", to_do="next_steps", machine="output") | DiagnosisResult.json_keys
    page_by = "ffcomp.report.diagnose:page_of"

    runs: Sequence[Path] = ()
    output: Path | None = None
    seconds: float = 0.0

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
