"""Tasks that share the processors, or the computers of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import TypeVar

from ffcomp.simulate.playback import JOBS

T = TypeVar("T")
Progress = Callable[[str, float], None]  # what is being done, and how much is done (0 to 1)


class Stages:
    """Turn the progress of one stage after the other into that of the whole."""

    def __init__(self, progress: Progress, shares: Mapping[str, float]) -> None:
        """Keep the stages in their order, each with its share of the time, in any unit."""
        self._progress, self._shares = progress, shares

    def __call__(self, what: str, share: float) -> None:
        """Tell the stage, its number, and the share of the whole that is done."""
        names = list(self._shares)
        number = names.index(what)
        before = sum(self._shares[name] for name in names[:number])
        done = (before + share * self._shares[what]) / sum(self._shares.values())
        self._progress(f"[{number + 1}/{len(names)}] {what}", done)


def in_parallel(tasks: Sequence[Callable[[], T]], what: str, progress: Progress) -> list[T]:
    """Do the tasks in parallel; an interruption waits only for those that are running."""
    progress(what, 0.0)
    pool = ThreadPoolExecutor(JOBS)
    try:
        futures = [pool.submit(task) for task in tasks]
        found = []
        for k, future in enumerate(futures):
            found.append(future.result())
            progress(what, (k + 1) / len(tasks))
        return found
    finally:
        pool.shutdown(cancel_futures=True)


def in_processes(tasks: Sequence[Callable[[], T]], jobs: int, what: str, progress: Progress) -> list[T]:
    """Do the tasks in so many processes, or in threads of this one if it is one.

    With several jobs call it within `workers`; then tasks and what they return are pickled.
    """
    if jobs == 1:
        return in_parallel(tasks, what, progress)
    from joblib import Parallel, delayed

    progress(what, 0.0)
    pool = Parallel(n_jobs=jobs, return_as="generator", batch_size=1, pre_dispatch="2 * n_jobs")
    found = []
    with closing(pool(delayed(_done)(task) for task in tasks)) as coming:
        for result in coming:
            found.append(result)
            progress(what, len(found) / len(tasks))
    return found


def _done(task: Callable[[], T]) -> T:
    return task()
