"""Files side by side: each is one task for whichever process is free, here or far away.

Only the process that was asked writes the user's files. The others hand over drafts, which end in one place whatever
becomes of them, or bytes where they may not see our files.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.compensation.result import FileResult, attempt, failure_of
from ffcomp.errors import FfcompError
from gcode.atomic_write import replace_atomically
from gcode.errors import GcodeError
from gcode.text import raw_blocks
from models.machine import Machine

MARK = ".done"  # of the file whose length says how many bytes of its print are done


@dataclass(frozen=True, slots=True)
class _Task:
    """A file for another process."""

    number: int
    file: Path
    data: bytes | None  # its content, for one that may not see it
    draft: Path | None  # where the result goes; None: back, if there is `data`, or nowhere
    wanted: bool  # is there to be a result?


@dataclass(frozen=True, slots=True)
class _Done:
    """What another process gives back."""

    outcome: FileResult
    text: bytes | None = None


@dataclass(frozen=True, slots=True)
class Pool:
    """Files side by side."""

    files: Sequence[Path]
    targets: Sequence[Path | None]
    machine: Machine
    options: Options
    jobs: int
    drafts: ExitStack | None  # what removes the folders of drafts; None: the processes may not see our files
    folders: dict[Path, Path] = field(default_factory=dict)

    def under_way(self) -> int:
        """Bytes that are done of the files that are not, as far as their processes tell."""
        done = 0
        for folder in list(self.folders.values()):
            for mark in folder.glob("*" + MARK):
                with suppress(FileNotFoundError):  # done in the meantime
                    done += mark.stat().st_size
        return done

    def outcomes(self, numbers: Sequence[int]) -> Generator[FileResult, None, None]:
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
                    yield from self.outcomes([number])
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

        file = self.files[number]
        try:
            data = b"".join(raw_blocks(file)) if self.drafts is None else None
            task = _Task(number, file, data, self._draft(number), self.targets[number] is not None)
        except (OSError, GcodeError) as error:
            return delayed(_Done)(self._failed(number, error))
        return delayed(_work)(task, self.machine, self.options)

    def _draft(self, number: int) -> Path | None:
        """In a folder beside the target, which has room for it; one for all files that go there."""
        target = self.targets[number]
        if target is None or self.drafts is None:
            return None
        place = target.resolve().parent
        if place not in self.folders:
            made = TemporaryDirectory(prefix=".ffcomp-", dir=place, ignore_cleanup_errors=True)
            self.folders[place] = Path(self.drafts.enter_context(made))
        return self.folders[place] / str(number)

    def _written(self, done: _Done) -> FileResult:
        outcome, target = done.outcome, self.targets[done.outcome.number]
        for folder in self.folders.values():
            (folder / f"{outcome.number}{MARK}").unlink(missing_ok=True)
        if outcome.done is None:
            return outcome
        file = self.files[outcome.number]
        if outcome.done.already and (target is None or (target.exists() and target.samefile(file))):
            return replace(outcome, done=replace(outcome.done, output=str(file)))
        if target is None:
            return replace(outcome, done=replace(outcome.done, output=None))
        try:
            if done.text is None:
                draft = Path(str(outcome.done.output))
                replace_atomically(target, raw_blocks(draft))
                draft.unlink()
            else:
                replace_atomically(target, [done.text])
        except OSError as error:
            return self._failed(outcome.number, error)
        return replace(outcome, done=replace(outcome.done, output=str(target)))

    def _failed(self, number: int, error: Exception) -> FileResult:
        file = self.files[number]
        return FileResult(number, file, 0.0, None, failure_of(error, str(file)))


@contextmanager
def _closing(answers: Generator[_Done, None, None]) -> Iterator[Generator[_Done, None, None]]:
    """Whoever stops early wants the others' work to end, and knows that it is lost: no warning."""
    try:
        yield answers
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            answers.close()


def _work(task: _Task, machine: Machine, options: Options) -> _Done:

    def to(draft: Path | None, progress: Callable[[float], None]) -> FileResult:
        source = task.file if task.data is None else task.data
        return attempt(
            task.number,
            task.file,
            lambda path: compensate_file(source, str(path), machine, options, draft, progress=progress),
        )

    if task.data is None and task.draft is not None:
        return _Done(to(task.draft, _marking(task.draft.with_suffix(MARK), task.file)))
    if task.data is None or not task.wanted:
        return _Done(to(None, lambda share: None))
    with TemporaryDirectory() as folder:
        draft = Path(folder) / "draft"
        return _Done(to(draft, lambda share: None), draft.read_bytes() if draft.exists() else None)


def _marking(mark: Path, file: Path) -> Callable[[float], None]:
    """Progress, told to another process by the length of a file: it is never half told."""

    def progress(share: float) -> None:
        with open(mark, "ab") as mark_file:
            mark_file.truncate(round(share * file.stat().st_size))

    return progress
