"""Tasks that share the processors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from ffcomp.simulate.playback import JOBS

T = TypeVar("T")
Progress = Callable[[str, float], None]  # what is being done, and how much of it (0 to 1)


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
