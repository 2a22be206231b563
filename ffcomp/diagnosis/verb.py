"""The verb `diagnose`: files in; the verdict, what to record next, and the better machine file out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from math import inf
from pathlib import Path
from typing import Any

from ffcomp.diagnosis.diagnosis import Diagnosis as Search
from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.hypotheses import FAMILIES
from ffcomp.diagnosis.next_experiment import Proposal, propose
from ffcomp.diagnosis.print_gain import PrintGain, print_gain
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Problem
from ffcomp.diagnosis.problems import check_recordings, paths_of, plant_of, problem_of, recordings_of
from ffcomp.diagnosis.request import DiagnoseRequest
from ffcomp.diagnosis.result import DiagnosisResult, better_file, result_of
from ffcomp.diagnosis.sentences import summary_sentences, what_to_do
from ffcomp.diagnosis.separation import separations
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.identification.machine_fit import hash_of
from ffcomp.numerics.stages import Progress
from ffcomp.record.axes import turn_of
from gcode.atomic_write import replace_atomically
from models.file import check_text


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis:
    """The effects that a machine file lacks, if any.

    Attributes
    ----------
    result : verdict, effects with intervals, retuned parameters and the discrepancy before and after
    search : everything that the verdict rests on
    print_gain : what prints gain by the better machine file; None: not predicted
    output, report : the improved machine file, the page; None: not written
    """

    result: DiagnosisResult
    problem: Problem
    search: Search
    runs: Sequence[Path]
    print_gain: PrintGain | None
    output: Path | None
    report: Path | None = None
    seconds: float

    @property
    def verdict(self) -> str:
        """Return "effects", "none" or "unknown"."""
        return self.result.verdict

    def better_file(self) -> str:
        """Return the text of the improved machine file."""
        assert self.output is not None
        hashes = [hash_of(path) for path in self.runs]
        text = better_file(Path(self.problem.path), self.output.stem, self.result, hashes, date.today().isoformat())
        check_text(text, str(self.output))
        return text

    def proposals(self) -> list[Proposal]:
        """Propose the moves that tell competing hypotheses apart; of an axis none, for it takes no G-code."""
        return propose(self.problem, self.search) if isinstance(self.problem, PrinterProblem) else []

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-diagnose/1."""
        return {
            **result_json(self.result, self.print_gain),
            "machine": None if self.output is None else str(self.output),
            "report": None if self.report is None else str(self.report),
            "seconds": self.seconds,
        }


def result_json(result: DiagnosisResult, gain: PrintGain | None = None) -> dict[str, Any]:
    """Return the JSON object ffcomp-diagnose/1 but for files and time; `gain` : of prints, if it was predicted."""
    gap = result.gap
    named = result.effects if result.verdict == "effects" else {}
    most = None if result.rest is None else {**_effect_json(result, result.named[0]), **result.rest.to_dict()}
    refused = {"effects": list(result.effects), "because": list(result.rejections)}
    return {
        "schema": "ffcomp-diagnose/1",
        "verdict": result.verdict,
        "finding": result.finding,
        "said": summary_sentences(result),
        "effects": [_effect_json(result, name) for name in named],
        "dominant": most,
        "undetermined": list(result.undetermined),
        "refused": refused if result.rejections else None,
        "invisible": list(result.invisible),
        "retuned": {key: {"from": a, "to": b} for key, (a, b) in result.file.retuned.items()},
        "separate": [each.to_dict() for each in result.separations],
        "confusable_with": [{"name": name, "separate_by": how} for name, how in result.confounded_with],
        "late_s": dict(result.late_s),
        "left_out": gap.left_out,
        "unproven_at": list(gap.unproven),
        "or_file_off": {key: {"from": a, "to": b} for key, (a, b) in result.file.off.items()},
        "cut_short": result.cut_short,
        "to_do": what_to_do(result),
        "print_gain": None if gain is None else gain.to_dict(),
        "gap": {
            "before": gap.before.nrms,
            "after": gap.after.nrms,
            "noise": gap.noise,
            "held_out": {"before": gap.elsewhere[0], "after": gap.elsewhere[1], "noise": gap.noise},
        },
    }


def _effect_json(result: DiagnosisResult, name: str) -> dict[str, Any]:
    return {
        "name": name,
        "family": FAMILIES.get(name, name),
        "parameters": result.parameters(name),
        "confidence": result.confidence[name],
        "evidence": result.evidence,
    }


def diagnose_files(request: DiagnoseRequest, search_progress: Progress | None = None) -> Diagnosis:
    """Diagnose recordings; nothing is written.

    Parameters
    ----------
    search_progress : of the search, if it is shown otherwise than the rest

    Raises
    ------
    MeasurementError, MachineFileError
    """
    began, plant, runs = time.monotonic(), plant_of(request.machine), paths_of(request.recordings)
    recordings = recordings_of(plant, runs, request.plan, turn_of(request.axes_map), request.progress)
    problem = problem_of(plant, recordings)
    check_recordings(problem, recordings, request.without_repeats)
    budget = inf if request.thorough else SETTINGS.budget_steps
    search = diagnose(problem, search_progress or request.progress, budget)
    result, gain = result_of(problem, search), None
    if isinstance(problem, PrinterProblem):  # one axis takes no G-code, prints nothing
        result = replace(result, separations=separations(problem, search))
        gain = print_gain(plant, result)
    return Diagnosis(
        result=result,
        problem=problem,
        search=search,
        runs=runs,
        print_gain=gain,
        output=Path(request.output) if request.output is not None and result.mends else None,
        seconds=time.monotonic() - began,
    )


def diagnose_request(request: DiagnoseRequest) -> Diagnosis:
    """Find the physical effect that a machine file lacks, and its size.

    The improved machine file is written only if an effect is named or retuning closes the discrepancy.

    Parameters
    ----------
    progress : takes sentences on what is being done

    Raises
    ------
    MeasurementError, MachineFileError
    """
    diagnosis = diagnose_files(request)
    if diagnosis.output is not None:
        replace_atomically(diagnosis.output, [diagnosis.better_file().encode()])
    return diagnosis
