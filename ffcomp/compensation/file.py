"""Compensate one file of any kind, by its options."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from os.path import realpath
from pathlib import Path

from ffcomp.compensation.job import Job
from ffcomp.compensation.request import CompensateOptions
from ffcomp.compensation.result import CompensatedFile, Result, already_compensated
from ffcomp.errors import LimitsError
from ffcomp.integrations.slicer import Bed
from ffcomp.inverse.settings import Settings
from gcode.atomic_write import replace_atomically, replacing, unchanged
from gcode.container import Container, blocks_of, ends_of, opened
from gcode.embedded import find_stamp
from gcode.errors import UnsupportedGcode
from gcode.text import raw_blocks
from models.machine import Machine


def compensate_file(
    source: bytes | Path,
    path: str,
    machine: Machine,
    request: CompensateOptions,
    target: Path | None,
    *,
    bed: Bed | None = None,
    inverse: Settings | None = None,
    jobs: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> CompensatedFile:
    """Compensate a file. With several jobs call it within `workers`.

    source : a file of any kind, or its content; the target becomes one of the same kind
    path : the file, as the user named it
    target : is replaced at the end or not at all; None: nothing is written
    bed : the slicer's, if it has said it otherwise than in the file
    inverse : settings of the inverse, where a comparison has chosen them
    jobs : processes that work at it
    progress : called with the share of the file that is done, 0 to 1
    """
    still_the_same = unchanged(source)
    with opened(source, path) as container:
        stamps = {name: find_stamp(*ends_of(text)[:2]) for name, text in container.prints.items()}
        again = request.force or request.kind != "gcode"
        todo = {
            name: Job(
                *(text, f"{path}/{name}" if name else path, machine, request, bed),
                restore=stamps[name] is not None,
                jobs=jobs,
                inverse=inverse,
            )
            for name, text in container.prints.items()
            if again or stamps[name] is None
        }
        if not todo:
            if target is None or (isinstance(source, Path) and target.exists() and target.samefile(source)):
                return already_compensated(path, stamps.values(), Path(path))
            replace_atomically(target, raw_blocks(source) if isinstance(source, Path) else [source])
            return already_compensated(path, stamps.values(), target)
        if request.kind == "gcode":
            results = _write(container, todo, target, progress, still_the_same)
        else:
            if len(todo) > 1:
                several = ", ".join(todo)
                raise UnsupportedGcode(f"Step timings are of one print, and the file holds {several}.", path=path)
            results = {name: job.write_steps(target, progress) for name, job in todo.items()}
        return CompensatedFile(path, target, results)


def _write(
    container: Container,
    todo: Mapping[str, Job],
    target: Path | None,
    progress: Callable[[float], None],
    check: Callable[[], None],
) -> dict[str, Result]:
    """Rewrite the container; other files in it are copied unchanged.

    todo : by the print's name;  check : is called before the target is replaced
    """
    sizes, folder = [job.size for job in todo.values()], None if target is None else Path(realpath(target)).parent

    def tell(number: int, share: float) -> None:
        progress((sum(sizes[:number]) + share * sizes[number]) / max(sum(sizes), 1))

    streams = {name: job.lines(partial(tell, k), folder) for k, (name, job) in enumerate(todo.items())}
    texts = (iter(streams[name]) if name in streams else blocks_of(text) for name, text in container.prints.items())
    if target is None:
        for lines in texts:
            deque(lines, maxlen=0)
    else:
        with replacing(target) as file:
            container.write(file, texts)
            check()
            for name, job in todo.items():
                if job.settings.slowing.strict and (missed := streams[name].value.bound_missed):
                    raise LimitsError(missed[0])
    return {name: stream.value for name, stream in streams.items()}
