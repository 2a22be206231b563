"""One file, by its options: compensated, or the sentence that says why not."""

from __future__ import annotations

import pickle
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ffcomp.errors import FfcompError
from ffcomp.invert.inverter import Inverter
from ffcomp.invert.settings import Settings
from ffcomp.job import Job, find_offset
from ffcomp.pipeline import settings_for
from ffcomp.steps.sink import Board
from gcode.container import ends_of
from gcode.errors import GcodeError
from gcode.metadata import Stamp, find_stamp
from models.errors import MachineFileError
from models.machine import Machine

DIED = "A process that worked at it has died, perhaps for want of memory."


@dataclass(frozen=True, slots=True)
class StepOutput:
    """Step timings instead of G-code."""

    board: Board
    error_s: float | None  # of a compressed step; None: every step, exactly
    plain: bool = False  # uncompensated


@dataclass(frozen=True, slots=True)
class Options:
    """How files are compensated: all that a `Job` is told besides the file, the machine and who works at it."""

    offset: tuple[float, float] = (0.0, 0.0)  # mm
    flavor: str = ""  # "": what the file says
    settings: Settings | None = None  # None: what the machine's limits give
    predict: bool = True
    shaper_off: bool = False
    force: bool = False  # compensate again what is stamped
    steps: StepOutput | None = None  # None: G-code

    def job(self, source: bytes | Path, path: str, machine: Machine, stamp: Stamp | None, jobs: int) -> Job:
        """The one place where options become a job. With a stamp, the original that the file keeps is compensated."""
        settings = self.settings or settings_for(machine)
        known = stamp is not None and not any(self.offset)
        return Job(
            source,
            path,
            machine,
            offset=find_offset(ends_of(source)[0]) if known else self.offset,
            flavor=self.flavor,
            predict=self.predict,
            settings=settings,
            shaper_off=self.shaper_off,
            inverter=_inverter(machine, settings),
            restore=stamp is not None,
            jobs=jobs,
        )


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a file was not compensated."""

    sentence: str
    exit_code: int
    trace: str = ""  # of an error of our own


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one file."""

    number: int  # its place among the files given
    file: Path
    seconds: float
    result: dict[str, Any]  # as `Job.result`, with "output", or with "already"; empty for a failure
    failure: Failure | None = None


def compensate_file(
    source: bytes | Path,
    path: str,
    machine: Machine,
    options: Options,
    target: Path | None,
    *,
    jobs: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """The JSON object of `compensate`. With several jobs call it within `workers`.

    progress : called with the share of the file that is done
    """
    head, tail, _ = ends_of(source)
    stamp = find_stamp(head, tail)
    if stamp is not None and not options.force and options.steps is None:
        already = f"{path}: already processed by ffcomp v{stamp.version} for {stamp.machine}; nothing changed."
        return {"schema": "ffcomp-compensate/1", "input": path, "output": path, "already": already}
    job = options.job(source, path, machine, stamp, jobs)
    output = None if target is None else str(target)
    if options.steps is None:
        job.write(target, progress)
        return {**job.result(), "output": output}
    asked = options.steps
    totals = job.write_steps(target, asked.board, asked.error_s, asked.plain, progress)
    return {**job.result(), "output": output, "steps": {motor: asdict(total) for motor, total in totals.items()}}


def outcome_of(number: int, file: Path, work: Callable[[Path], dict[str, Any]]) -> Outcome:
    """What becomes of a file when this is done with it; no error stops whoever does many."""
    started, result, failure = time.perf_counter(), dict[str, Any](), None
    try:
        result = work(file)
    except Exception as error:
        failure = failure_of(error, str(file))
    return Outcome(number, file, time.perf_counter() - started, result, failure)


def failure_of(error: Exception, path: str) -> Failure:
    """A sentence and the documented exit code."""
    if isinstance(error, FfcompError):
        return Failure(str(error), error.exit_code)
    if isinstance(error, GcodeError):
        return Failure(str(error), 4)
    if isinstance(error, MachineFileError):
        return Failure(str(error), 5)
    if isinstance(error, OSError):
        return Failure(f"{error.filename or path}: {error.strerror or error}.", 2)
    if isinstance(error, BrokenExecutor):
        return Failure(f"{path}: {DIED}", 1)
    trace = "".join(traceback.format_exception(error))
    return Failure(f"{path}: ffcomp itself is at fault ({type(error).__name__}: {error}).", 1, trace)


_own = threading.local()  # a thread's machine, from file to file


def _inverter(machine: Machine, settings: Settings) -> Inverter:
    key = pickle.dumps((machine, settings))
    if getattr(_own, "key", None) != key:
        _own.inverter, _own.key = Inverter(machine, settings), key
    inverter: Inverter = _own.inverter
    return inverter
