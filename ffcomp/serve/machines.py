"""The machines that a person can choose, and machine files that jobs have made, kept among the user's own."""

from __future__ import annotations

import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ffcomp.serve.commands import BETTER, NAME, UPDATES
from ffcomp.serve.jobs import DONE, Job, JobFolder
from ffcomp.serve.uploads import Refused
from models.finding import machine_paths, named_machines, user_folder


def listed() -> list[dict[str, Any]]:
    """Return every machine that has a name, as the page lists it; `own` are the user's."""
    return [
        {"name": each.name, "kinematics": each.kinematics, "printer": each.printer, "own": each.origin == "user"}
        for each in named_machines()
    ]


def path_of(name: str) -> Path:
    """Return the file of a machine; Refused if no machine has this name."""
    paths = machine_paths()
    if name not in paths:
        raise Refused(400, f"There is no machine {name[:60]!r}: choose one, or import yours.")
    return paths[name]


def keep(job: Job, kept: JobFolder, name: str) -> str:
    """Copy the machine file that a job has made among the user's own, and return its name.

    Raises Refused if the job has made none, the name is none, or a machine has it already.
    """
    if not NAME.fullmatch(name):
        raise Refused(400, "A machine's name has letters, digits, - and _ only.")
    if name in machine_paths():
        raise Refused(409, f"There is a machine {name} already; choose another name.")
    made = kept.output(job, BETTER)
    with suppress(FileNotFoundError):
        shutil.copyfile(made.with_suffix(UPDATES), user_folder() / f"{name}{UPDATES}")
    return _copied(made, name)


def kept_if_imported(job: Job, place: Path) -> Job:
    """Keep the machine file of an import that went well, under its own name or the next one that is free."""
    if job.kind != "import" or job.state != DONE:
        return job
    made = [place / "out" / name for name in job.outputs] or [place / "in" / job.inputs[0]]
    wanted = made[0].stem if NAME.fullmatch(made[0].stem) else "my-printer"
    taken = machine_paths()
    name = next(each for each in (wanted, *(f"{wanted}-{k}" for k in range(2, 1000))) if each not in taken)
    return replace(job, kept=_copied(made[0], name))


def _copied(source: Path, name: str) -> str:
    target = user_folder() / f"{name}.toml"
    target.parent.mkdir(parents=True, exist_ok=True)
    with open(target, "xb") as file:
        file.write(source.read_bytes())
    return name
