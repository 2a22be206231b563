"""Many files, on the cores of this computer or on a cluster.

A file is one task, the biggest first (`ffcomp.compensation.worker_pool`). Where the others would have to wait for a
file at last, all processes work at it together instead, chunk by chunk. The bytes are those of a single process.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from os.path import normcase, realpath
from pathlib import Path

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.compensation.request import CompensateFilesRequest
from ffcomp.compensation.result import DIED, FileResult, attempt
from ffcomp.compensation.worker_pool import Pool
from ffcomp.errors import FfcompError, RequestError
from gcode.text import PART_BYTES
from models.machine import Machine

LARGEST_SENT = 8 << 20  # bytes of a file that goes to a cluster whole; what comes back is ten times as much
TELL_S = 0.5  # from one word on progress to the next


def compensate_files(
    files: Sequence[Path],
    machine: Machine,
    options: Options = Options(),  # noqa: B008 (frozen)
    *,
    targets: Sequence[Path | None] | None = None,
    jobs: int = 1,
    scheduler: str = "",
    progress: Callable[[float], None] = lambda done: None,
) -> Generator[FileResult, None, None]:
    """Compensate files; what became of each comes as soon as it is known. A file that fails does not stop the others.

    Parameters
    ----------
    targets : where each goes, None for nowhere; by default in place
    jobs : processes on this computer
    scheduler : address of a Dask scheduler, whose workers then do the work; they need not see the files
    progress : called with the bytes of input that are done

    Raises
    ------
    RequestError
        If two files have one target, or one is the target of another.
    """
    chosen: list[Path | None] = list(files) if targets is None else list(targets)
    check_targets(files, chosen)
    return _Batch(list(files), chosen, machine, options, progress).run(jobs, scheduler)


def targets_in(folder: Path, files: Sequence[Path]) -> list[Path]:
    """Where files go that keep their names; never over the files themselves."""
    targets = [folder / file.name for file in files]
    for file, target in zip(files, targets, strict=True):
        if _same(target) == _same(file):
            raise RequestError(f"{file}: this file is in {folder} itself, and would be overwritten.")
    check_targets(files, targets)
    return targets


def targets_of(request: CompensateFilesRequest) -> list[Path] | list[None]:
    """Choose the target of each file: what is no G-code never replaces any."""
    files = list(request.files)
    targets = files if request.output_dir is None else targets_in(request.output_dir, files)
    if request.kind != "gcode":
        targets = [target.with_suffix(".ffm" if request.kind == "host" else ".npz") for target in targets]
    check_targets(files, targets)
    if request.dry_run:
        return [None] * len(files)
    if request.output_dir is not None:
        request.output_dir.mkdir(parents=True, exist_ok=True)
    return [request.output] if request.output is not None else targets


def check_targets(files: Sequence[Path], targets: Sequence[Path | None]) -> None:
    """No two files go to one place, and none to where another one is read."""
    inputs = {_same(file): file for file in files}
    taken: dict[object, Path] = {}
    for file, target in zip(files, targets, strict=True):
        if target is None:
            continue
        place = _same(target)
        if place in taken:
            raise RequestError(f"{taken[place]} and {file} would both be written to {target}.")
        if place in inputs and place != _same(file):
            raise RequestError(f"{file} would be written over {inputs[place]}, which is read as well.")
        taken[place] = file


def _same(path: Path) -> object:
    """Equal for two names of one file."""
    try:
        found = path.stat()
    except OSError:
        return normcase(realpath(path))
    return found.st_dev, found.st_ino


@contextmanager
def workers(jobs: int, scheduler: str = "") -> Iterator[int]:
    """Within it tasks go to so many processes of this computer, or to a cluster; yields how many work at once."""
    if jobs == 1 and not scheduler:
        yield 1
        return
    from joblib import parallel_config

    try:
        if scheduler:
            from ffcomp.compensation.dask_backend import cluster

            with cluster(scheduler) as far, parallel_config(backend=far):
                yield far.effective_n_jobs(-1)
        else:
            with parallel_config(backend="loky", inner_max_num_threads=1):
                yield jobs
    except BrokenExecutor as error:
        raise FfcompError(DIED) from error


@dataclass(frozen=True, slots=True)
class _Batch:
    files: list[Path]
    targets: list[Path | None]
    machine: Machine
    options: Options
    progress: Callable[[float], None]

    def run(self, jobs: int, scheduler: str) -> Generator[FileResult, None, None]:
        sizes, done = [size_of(file) for file in self.files], 0
        tell = _Forwards(self.progress)
        with workers(jobs, scheduler) as at_once, ExitStack() as drafts:
            alone, together = _shares(sizes, at_once, LARGEST_SENT if scheduler else math.inf)
            for number in alone:
                yield self._alone(number, at_once, _share_of(sizes[number], done, tell))
                done += sizes[number]
                tell(done)
            pool = Pool(self.files, self.targets, self.machine, self.options, at_once, None if scheduler else drafts)
            with _told(lambda: done + pool.under_way(), tell), closing(pool.outcomes(together)) as outcomes:
                for outcome in outcomes:
                    done += sizes[outcome.number]
                    tell(done)
                    yield outcome

    def _alone(self, number: int, jobs: int, progress: Callable[[float], None]) -> FileResult:
        """Compensate a file that all processes work at."""
        machine, options, target = self.machine, self.options, self.targets[number]
        return attempt(
            number,
            self.files[number],
            lambda path: compensate_file(path, str(path), machine, options, target, jobs=jobs, progress=progress),
        )


class _Forwards:
    """Progress that never goes back, whichever thread tells it."""

    def __init__(self, tell: Callable[[float], None]) -> None:
        self._tell, self._furthest, self._telling = tell, 0.0, threading.Lock()

    def __call__(self, done: float) -> None:
        with self._telling:
            if done > self._furthest:
                self._furthest = done
                self._tell(done)


def _share_of(size: int, before: int, tell: Callable[[float], None]) -> Callable[[float], None]:
    """Progress of one file as progress of all."""
    return lambda share: tell(before + share * size)


@contextmanager
def _told(done: Callable[[], float], tell: Callable[[float], None]) -> Iterator[None]:
    """Meanwhile what is done is told now and then, from a thread: we wait for others, who cannot call us."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(TELL_S):
            tell(done())

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _shares(sizes: Sequence[int], jobs: int, largest: float) -> tuple[list[int], list[int]]:
    """Which files all work at together, one after the other, and which are done side by side; the biggest first.

    Of all ways the one that takes least, in bytes: no file side by side is quicker than one process can be, and none
    that all work at is quicker than a chunk.
    """
    if jobs == 1:
        return list(range(len(sizes))), []
    order = sorted(range(len(sizes)), key=lambda number: -sizes[number])
    ordered = [sizes[number] for number in order]

    def cost(alone: int) -> float:
        rest = ordered[alone:]
        by_all = sum(max(size / jobs, PART_BYTES) for size in ordered[:alone])
        return by_all + max(sum(rest) / jobs, max(rest, default=0))

    least = sum(size > largest for size in sizes)
    alone = min(range(least, max(least, min(jobs, len(sizes))) + 1), key=cost)
    return order[:alone], order[alone:]


def size_of(file: Path) -> int:
    """In bytes; 0 for a file that cannot be looked at: the error is said when it is that file's turn."""
    try:
        return file.stat().st_size
    except OSError:
        return 0
