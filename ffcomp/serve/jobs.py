"""Stored jobs: one folder each, so that they outlive the page, the browser and the server.

In it, `job.json` is the job, replaced as a whole; `in/` holds the files that it was given, `out/` those that it makes;
`N.json` is the stdout of step N, `N.events` its progress, and `log.txt` the stderr of all steps.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ffcomp.result import Answer
from ffcomp.serve.uploads import ID, Refused
from gcode.atomic_write import replace_atomically

QUEUED, RUNNING, DONE, FAILED, CANCELLED = "queued", "running", "done", "failed", "cancelled"
ENDED = (DONE, FAILED, CANCELLED)


@dataclass(frozen=True, slots=True)
class Job:
    """One piece of work; times in seconds since 1970, 0 for not yet."""

    id: str  # its folder's name
    kind: str  # one of `commands.KINDS`
    title: str  # what a person calls it
    machine: str = ""  # its name; empty where none is needed
    inputs: tuple[str, ...] = ()  # names of the files in `in/`
    options: dict[str, Any] = field(default_factory=dict)  # checked
    created: float = 0.0
    started: float = 0.0
    ended: float = 0.0
    state: str = QUEUED
    share: float | None = None  # that is done, 0 to 1; None: unknown
    doing: str = ""
    error: str = ""  # why it failed, in a sentence
    outputs: tuple[str, ...] = ()  # names of the files in `out/`
    answer: Answer = field(default_factory=Answer)  # as the page shows it
    kept: str = ""  # the name of the machine that it has made and kept
    pid: int = 0  # while it runs


class JobFolder:
    """The folder with all jobs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def place(self, id_: str) -> Path:
        """Return a job's folder; Refused if that is no job's name."""
        if not ID.fullmatch(id_):
            raise Refused(404, "There is no such job.")
        return self.folder / id_

    def write(self, job: Job) -> None:
        """Store a job."""
        replace_atomically(self.place(job.id) / "job.json", [json.dumps(asdict(job)).encode()])

    def read_all(self) -> Iterator[Job]:
        """Read every job that can be read; one that cannot was cut off while it was made, and is removed."""
        for place in sorted(self.folder.iterdir()):
            if not ID.fullmatch(place.name):
                continue
            try:
                kept = json.loads((place / "job.json").read_text(encoding="utf-8"))
                names = {name: tuple(kept[name]) for name in ("inputs", "outputs")}
                answer = {name: each for name, each in kept["answer"].items() if name in Answer.__slots__}
                yield Job(**kept | names | {"answer": Answer(**answer)})
            except (OSError, ValueError, TypeError, KeyError):
                shutil.rmtree(place, ignore_errors=True)

    def remove(self, id_: str) -> None:
        """Remove a job and all its files."""
        shutil.rmtree(self.place(id_), ignore_errors=True)

    def output(self, job: Job, name: str) -> Path:
        """Return the path of a file that a job has made, if the job itself names it; Refused if it does not."""
        path = self.place(job.id) / "out" / name
        if name not in job.outputs or not path.is_file():
            raise Refused(404, "There is no such file.")
        return path
