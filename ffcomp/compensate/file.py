"""One file, by its options: compensated, or the sentence that says why not."""

from __future__ import annotations

import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor
from dataclasses import asdict, dataclass
from os.path import realpath
from pathlib import Path
from typing import Any

from ffcomp.compensate.job import Job, inverter_of
from ffcomp.errors import INPUT_ERRORS, explain
from ffcomp.inverse.settings import Settings, settings_for
from ffcomp.steps.sink import Board
from gcode.atomic_write import replacing, unchanged
from gcode.container import Container, Source, blocks_of, ends_of, opened
from gcode.errors import UnsupportedGcode
from gcode.stamp import Stamp, find_offset, find_stamp
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

    def job(self, source: Source, path: str, machine: Machine, stamp: Stamp | None, jobs: int) -> Job:
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
            inverter=inverter_of(machine, settings),
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

    source : a file of any kind, or its content; the target becomes one of the same kind
    progress : called with the share of the file that is done
    """
    still_the_same = unchanged(source)
    with opened(source, path) as container:
        stamps = {name: find_stamp(*ends_of(text)[:2]) for name, text in container.prints.items()}
        again = options.force or options.steps is not None
        todo = {
            name: options.job(text, f"{path}/{name}" if name else path, machine, stamps[name], jobs)
            for name, text in container.prints.items()
            if again or stamps[name] is None
        }
        if not todo:
            return _already(path, stamps.values())
        if options.steps is None:
            _write(container, todo, target, progress, still_the_same)
            result = _result(todo)
        else:
            result = _write_steps(todo, path, target, options.steps, progress)
        return {**result, "input": path, "output": None if target is None else str(target)}


def _already(path: str, stamps: Iterable[Stamp | None]) -> dict[str, Any]:
    by = " and ".join(dict.fromkeys(f"ffcomp v{stamp.version} for {stamp.machine}" for stamp in stamps if stamp))
    already = f"{path}: already processed by {by}; nothing changed."
    return {"schema": "ffcomp-compensate/1", "input": path, "output": path, "already": already}


def _write(
    container: Container,
    todo: Mapping[str, Job],
    target: Path | None,
    progress: Callable[[float], None],
    check: Callable[[], None],
) -> None:
    """The container anew. todo : by the print's name; prints that are not in it stay as they are.

    check : is called before the target is replaced
    """
    texts = _texts(container, todo, None if target is None else Path(realpath(target)).parent, progress)
    if target is None:
        for lines in texts:
            deque(lines, maxlen=0)
    else:
        with replacing(target) as file:
            container.write(file, texts)
            check()


def _texts(
    container: Container, todo: Mapping[str, Job], folder: Path | None, progress: Callable[[float], None]
) -> Iterator[Iterator[bytes]]:
    done, whole = 0, max(sum(job.size for job in todo.values()), 1)
    for name, text in container.prints.items():
        if name not in todo:
            yield blocks_of(text)
            continue
        size = todo[name].size

        def tell(share: float, done: int = done, size: int = size) -> None:
            progress((done + share * size) / whole)

        yield todo[name].lines(tell, folder)
        done += size


def _result(todo: Mapping[str, Job]) -> dict[str, Any]:
    """Of one print, or of all together."""
    first, *others = todo.values()
    if not others:
        return first.result()
    warnings = [f"{name}: {warning}" for name, job in todo.items() for warning in job.warnings]
    times = ("print_time_s", "original_print_time_s")
    prints = [{"name": name, **{key: getattr(job.summary, key) for key in times}} for name, job in todo.items()]
    for other in others:
        first.add(other)
    return {**first.result(), "warnings": warnings, "prints": prints}


def _write_steps(
    todo: Mapping[str, Job], path: str, target: Path | None, asked: StepOutput, progress: Callable[[float], None]
) -> dict[str, Any]:
    if len(todo) > 1:
        raise UnsupportedGcode(f"Step timings are of one print, and the file holds {', '.join(todo)}.", path=path)
    (job,) = todo.values()
    totals = job.write_steps(target, asked.board, asked.error_s, asked.plain, progress)
    return {**job.result(), "steps": {motor: asdict(total) for motor, total in totals.items()}}


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
    if isinstance(error, INPUT_ERRORS):
        return Failure(*explain(error, path))
    if isinstance(error, BrokenExecutor):
        return Failure(f"{path}: {DIED}", 1)
    trace = "".join(traceback.format_exception(error))
    return Failure(f"{path}: ffcomp itself is at fault ({type(error).__name__}: {error}).", 1, trace)
