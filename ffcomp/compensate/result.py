"""Hold the results of a compensation: of one print, of one file among many, or why there is none."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ffcomp.compensate.placement import Placement
from ffcomp.compensate.statistics import Statistics, warning_lines
from ffcomp.errors import INPUT_ERRORS, explain, interrupts_restored
from ffcomp.inverse.robust import PLAIN, RobustChoice
from ffcomp.numerics.serialise import to_json
from ffcomp.steps.sink import MotorTotal
from gcode.dialects import FlavorChoice
from gcode.embedded import Stamp
from models.machine import Machine, identity

SCHEMA = "ffcomp-compensate/1"
LISTED = 12  # places that were slowed down, of which each has its sentence
DIED = "A process that worked at it has died, perhaps for want of memory."


@dataclass(frozen=True, slots=True)
class Result:
    """What the compensation of a print has given."""

    path: str
    machine: Machine
    flavor: FlavorChoice
    placement: Placement
    statistics: Statistics
    compute_time_s: float
    steps: Mapping[str, MotorTotal] | None = None  # by the motor's letter; None: G-code was written
    embedded: bool = True  # whether the G-code holds its original
    robust: RobustChoice = PLAIN

    @property
    def warnings(self) -> list[str]:
        """All warnings, in sentences."""
        slowed = self.statistics.slowed
        sentences = [each.sentence() for each in slowed[:LISTED]]
        if len(slowed) > LISTED:
            more_s = sum(each.seconds for each in slowed[LISTED:])
            sentences.append(
                f"{len(slowed) - LISTED} more places were slowed down in the same way, {more_s:.2g} s longer in all."
            )
        return [*self.statistics.shares.warnings(), *self.statistics.warnings, *sentences]

    @property
    def warning_lines(self) -> list[str]:
        """The same for people, in a few lines."""
        numbers = self.statistics
        warnings = [*numbers.shares.warnings(), *numbers.warnings]
        return warning_lines(warnings, numbers.slowed, self.machine, numbers.original_print_time_s)

    def _faster(self) -> dict[str, Any]:
        """Return what a bound on the error has given."""
        numbers, faster = self.statistics, self.statistics.faster
        assert faster is not None
        compensated = numbers.predicted.tracks()["compensated"] if numbers.predicted else None
        names = sorted(faster.original_s, key=lambda name: -faster.original_s[name])
        return {
            "print_time_s": numbers.print_time_s,
            "original_print_time_s": numbers.original_print_time_s,
            "actuator_limit_s": faster.actuator_limit_s,
            "limited_by": dict(faster.limited_by),
            "contour_p99_um": compensated.contour_p99_um if compensated else None,
            "contour_max_um": compensated.contour_max_um if compensated else None,
            "by_feature": {
                name: {"original_s": faster.original_s[name], "print_time_s": faster.planned_s.get(name, 0.0)}
                for name in names
            },
        }

    def __add__(self, other: Result) -> Result:
        """Add another print of the same file."""
        statistics, compute_time_s = self.statistics + other.statistics, self.compute_time_s + other.compute_time_s
        return replace(self, statistics=statistics, compute_time_s=compute_time_s)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of `compensate`."""
        numbers = self.statistics
        found = {
            "schema": SCHEMA,
            "input": self.path,
            "machine": identity(self.machine),
            "flavor": self.flavor.flavor,
            "flavor_reason": self.flavor.reason,
            "offset_mm": self.placement.offset,
            "offset_reason": self.placement.reason,
            "robust": self.robust.robust,
            "robust_reason": self.robust.reason,
            "print_time_s": numbers.print_time_s,
            "original_print_time_s": numbers.original_print_time_s,
            "compute_time_s": self.compute_time_s,
            **numbers.shares.to_dict(),
            "settling": {"times": numbers.settlings, "seconds": numbers.settling_s},
            "moves": numbers.moves,
            "segments": numbers.segments,
            "windows": numbers.windows,
            "limited_windows": numbers.limited_windows,
            "warnings": self.warnings,
            "warning_lines": self.warning_lines,
            "slowed": numbers.slowed,
            "predicted": numbers.predicted.tracks() if numbers.predicted else {},
            "predicted_over_s": numbers.predicted.covered_s if numbers.predicted else 0.0,
            **({"faster": self._faster()} if numbers.faster is not None else {}),
            **({"original_embedded": self.embedded} if self.steps is None else {"steps": self.steps}),
        }
        return dict(to_json(found))


def of_prints(results: Mapping[str, Result]) -> dict[str, Any]:
    """Return the JSON object of a file's only print, or of all its prints together.

    Parameters
    ----------
    results : mapping of Result
        By the print's name.
    """
    first, *others = results.values()
    if not others:
        return first.to_dict()
    warnings = [f"{name}: {warning}" for name, result in results.items() for warning in result.warnings]
    times = ("print_time_s", "original_print_time_s")
    prints = [{"name": n, **{key: getattr(r.statistics, key) for key in times}} for n, r in results.items()]
    for other in others:
        first += other
    return {**first.to_dict(), "warnings": warnings, "prints": prints}


def already_processed(path: str, stamps: Iterable[Stamp | None]) -> dict[str, Any]:
    """Return the JSON object of a file that is compensated already."""
    by = " and ".join(dict.fromkeys(f"ffcomp v{stamp.version} for {stamp.machine}" for stamp in stamps if stamp))
    sentence = f"{path}: already processed by {by}; nothing changed."
    return {"schema": SCHEMA, "input": path, "output": path, "already": sentence}


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a file was not compensated."""

    sentence: str
    exit_code: int
    trace: str = ""  # of a fault of our own


@dataclass(frozen=True, slots=True)
class FileResult:
    """The result of one file among many."""

    number: int  # its place among the files given
    file: Path
    seconds: float
    result: dict[str, Any]  # as `Result.to_dict`, with "output", or with "already"; empty for a failure
    failure: Failure | None = None


def attempt(number: int, file: Path, work: Callable[[Path], dict[str, Any]]) -> FileResult:
    """Run `work(file)` and return its result or failure; never raises."""
    started, result, failure = time.perf_counter(), dict[str, Any](), None
    try:
        with interrupts_restored():
            result = work(file)
    except Exception as error:
        failure = failure_of(error, str(file))
    return FileResult(number, file, time.perf_counter() - started, result, failure)


def failure_of(error: Exception, path: str) -> Failure:
    """Return an error's sentence and its documented exit code."""
    if isinstance(error, INPUT_ERRORS):
        return Failure(*explain(error, path))
    if isinstance(error, BrokenExecutor):
        return Failure(f"{path}: {DIED}", 1)
    trace = "".join(traceback.format_exception(error))
    return Failure(f"{path}: ffcomp itself is at fault ({type(error).__name__}: {error}).", 1, trace)
