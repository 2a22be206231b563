"""The machines that a person can choose, and machine files that jobs have made, kept among the user's own."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from ffcomp.serve.commands import BETTER, NAME
from ffcomp.serve.jobs import DONE, Job, JobFolder
from ffcomp.serve.uploads import Refused
from models.finding import LIBRARY, glance, machine_paths, user_folder


def listed() -> list[dict[str, Any]]:
    """Return every machine that has a name: `name`, `kinematics`, `printer`, and whether it is the user's `own`."""
    rows = []
    for name, path in machine_paths().items():
        kinematics, printer = _glanced(path, _changed(path))
        rows.append({"name": name, "kinematics": kinematics, "printer": printer, "own": path.parent != LIBRARY})
    return rows


@lru_cache(maxsize=512)
def _glanced(path: Path, changed: int) -> tuple[str | None, str | None]:
    """Read a file once for each time that it was changed: the page asks every second."""
    return glance(path)


def _changed(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:  # removed meanwhile
        return 0


def path_of(name: str) -> Path:
    """Return the file of a machine.

    Raises
    ------
    Refused
        If no machine has this name.
    """
    paths = machine_paths()
    if name not in paths:
        raise Refused(400, f"There is no machine {name[:60]!r}: choose one, or import yours.")
    return paths[name]


def keep(job: Job, kept: JobFolder, name: str) -> str:
    """Copy the machine file that a job has made among the user's own, and return its name.

    Raises
    ------
    Refused
        If the job has made none, the name is none, or a machine has it already.
    """
    if not NAME.fullmatch(name):
        raise Refused(400, "A machine's name has letters, digits, - and _ only.")
    if name in machine_paths():
        raise Refused(409, f"There is a machine {name} already; choose another name.")
    return _copied(kept.output(job, BETTER), name)


def kept_if_imported(job: Job, place: Path) -> Job:
    """Keep the machine file of an import that went well, under its own name or the next one that is free."""
    if job.kind != "import" or job.state != DONE:
        return job
    made = [place / "out" / name for name in job.outputs] or [place / "in" / job.inputs[0]]
    wanted = made[0].stem if NAME.fullmatch(made[0].stem) else "my-printer"
    taken = machine_paths()
    name = next(each for each in (wanted, *(f"{wanted}-{k}" for k in range(2, 1000))) if each not in taken)
    kept = _copied(made[0], name)
    return replace(job, answer=job.answer | {"kept": kept})


def _copied(source: Path, name: str) -> str:
    target = user_folder() / f"{name}.toml"
    target.parent.mkdir(parents=True, exist_ok=True)
    with open(target, "xb") as file:
        file.write(source.read_bytes())
    return name
