"""Many files, on the cores of this computer or on a cluster.

All processes work at a large file together, chunk by chunk. A small file is one task, the largest first. The bytes are
those of a single process.

Only the process that was called writes the user's files. The others return the content of the small ones.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from os.path import normcase, realpath
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.request import ENDINGS, CompensateOptions, CompensateRequest
from ffcomp.compensation.result import DIED, FileResult, attempt, failure_of
from ffcomp.errors import FfcompError, RequestError
from ffcomp.integrations.slicer import Bed
from gcode.atomic_write import replace_atomically
from gcode.errors import GcodeError
from gcode.text import PART_BYTES, raw_blocks
from models.machine import Machine

LARGEST = 8 << 20  # bytes of a file that one of several processes works at; its output has ten times as many


def compensate_files(
    files: Sequence[Path],
    targets: Sequence[Path | None],
    machine: Machine,
    request: CompensateOptions,
    *,
    bed: Bed | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> Generator[FileResult, None, None]:
    """Compensate files and yield each result when it is ready. A file that fails does not stop the others.

    targets : where each goes, None for nowhere
    request : with a scheduler, the workers of that cluster do the work; they need not see the files
    progress : called with the bytes of input that are done

    Raises RequestError if two files have one target, or one is the target of another.
    """
    check_targets(files, targets)
    sizes, done = [size_of(file) for file in files], 0
    with workers(request.jobs, request.scheduler) as at_once:
        batch = _Batch(files, targets, machine, request, bed, at_once)
        # a file of a few parts is too small to share; the largest come first
        order = sorted(range(len(files)), key=lambda number: -sizes[number])
        large = [n for n in order if at_once == 1 or sizes[n] > min(at_once * PART_BYTES, LARGEST)]
        for number in large:

            def within(share: float, before: int = done, size: int = sizes[number]) -> None:
                progress(before + share * size)

            yield batch.by_all(number, within)
            done += sizes[number]
            progress(done)
        with closing(batch.side_by_side(order[len(large) :])) as found:
            for outcome in found:
                done += sizes[outcome.number]
                progress(done)
                yield outcome


def targets_of(request: CompensateRequest, *, in_place: bool) -> list[Path] | list[None]:
    """Choose the target of each file: step timings never replace G-code.

    in_place : whether files are changed where no output is named
    """
    files, folder = list(request.paths), None if request.output_dir is None else Path(request.output_dir)
    targets = files if folder is None else [folder / file.name for file in files]
    if request.kind != "gcode":
        targets = [target.with_suffix(ENDINGS[request.kind]) for target in targets]
    check_targets(files, targets, in_place=folder is None)
    if request.dry_run or (folder is None and request.output is None and not in_place):
        return [None] * len(files)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    return [Path(request.output)] if request.output is not None else targets


def check_targets(files: Sequence[Path], targets: Sequence[Path | None], *, in_place: bool = True) -> None:
    """No two files go to one place, and none to where one is read: another one, or itself if not in place."""
    inputs = {_same(file): file for file in files}
    taken: dict[object, Path] = {}
    for file, target in zip(files, targets, strict=True):
        if target is None:
            continue
        place = _same(target)
        if place in taken:
            raise RequestError(f"{taken[place]} and {file} would both be written to {target}.")
        if place in inputs and not (in_place and place == _same(file)):
            raise RequestError(f"{file}: {inputs[place]}, which is read as well, would be overwritten.")
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
class _Done:
    """The answer of another process."""

    outcome: FileResult
    output: bytes | None = None  # content of the target; None: nothing to write


@dataclass(frozen=True, slots=True)
class _Batch:
    """Files and their targets."""

    files: Sequence[Path]
    targets: Sequence[Path | None]
    machine: Machine
    request: CompensateOptions
    bed: Bed | None
    jobs: int

    def by_all(self, number: int, progress: Callable[[float], None]) -> FileResult:
        """Compensate a file that all processes work at."""
        return attempt(
            number,
            self.files[number],
            lambda path: compensate_file(
                *(path, str(path), self.machine, self.request, self.targets[number]),
                bed=self.bed,
                jobs=self.jobs,
                progress=progress,
            ),
        )

    def side_by_side(self, numbers: Sequence[int]) -> Generator[FileResult, None, None]:
        """Yield the files' results. When a process dies, those that are left are tried one by one."""
        if not numbers:
            return
        left = list(numbers)
        try:
            with _closing(self._answers(numbers)) as answers:
                for done in answers:
                    left.remove(done.outcome.number)
                    yield self._written(done)
        except BrokenExecutor as error:
            if len(left) == 1:
                yield self._failed(left[0], error)
            else:
                for number in left:
                    yield from self.side_by_side([number])
        except FfcompError as error:
            lost = [FfcompError(f"{self.files[number]}: {error}") for number in left]
            yield from map(self._failed, left, lost)

    def _answers(self, numbers: Sequence[int]) -> Generator[_Done, None, None]:
        from joblib import Parallel

        several = max(2, min(self.jobs, len(numbers)))  # one would be this very process, and a death its own
        # one more than are at work: while a file is read and sent, nobody waits
        pool = Parallel(n_jobs=several, return_as="generator_unordered", batch_size=1, pre_dispatch="n_jobs + 1")
        outcomes: Generator[_Done, None, None] = pool(map(self._call, numbers))
        return outcomes

    def _call(self, number: int) -> Any:
        """Return what `Parallel` takes; never raises: its errors would be those of all files."""
        from joblib import delayed

        file, wanted = self.files[number], self.targets[number] is not None
        try:
            source = b"".join(raw_blocks(file)) if self.request.scheduler else file
        except (OSError, GcodeError) as error:
            return delayed(_Done)(self._failed(number, error))
        return delayed(_work)(number, file, source, wanted, (self.machine, self.request), self.bed)

    def _written(self, done: _Done) -> FileResult:
        outcome, target = done.outcome, self.targets[done.outcome.number]
        if outcome.done is None:
            return outcome
        file = self.files[outcome.number]
        if outcome.done.already and (target is None or (target.exists() and target.samefile(file))):
            return replace(outcome, outcome=replace(outcome.done, output=file))
        if target is not None:
            assert done.output is not None
            try:
                replace_atomically(target, [done.output])
            except OSError as error:
                return self._failed(outcome.number, error)
        return replace(outcome, outcome=replace(outcome.done, output=target))

    def _failed(self, number: int, error: Exception) -> FileResult:
        file = self.files[number]
        return FileResult(number, file, 0.0, failure_of(error, file))


@contextmanager
def _closing(answers: Generator[_Done, None, None]) -> Iterator[Generator[_Done, None, None]]:
    """Whoever stops early wants the others' work to end, and knows that it is lost: no warning."""
    try:
        yield answers
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            answers.close()


def _work(number: int, file: Path, source: Path | bytes, wanted: bool, how: tuple[Any, ...], bed: Bed | None) -> _Done:
    """Compensate a file in another process."""
    with TemporaryDirectory() as folder:
        draft = Path(folder, "draft")
        to, (machine, request) = draft if wanted else None, how
        outcome = attempt(number, file, lambda path: compensate_file(source, str(path), machine, request, to, bed=bed))
        return _Done(outcome, draft.read_bytes() if draft.exists() else None)


def size_of(file: Path) -> int:
    """Return the size in bytes; 0 for a file that cannot be read, whose error follows when it is compensated."""
    try:
        return file.stat().st_size
    except OSError:
        return 0
