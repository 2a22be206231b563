"""Jobs that run: a few processes at a time, watched, killed on request, and kept in their folders."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

from ffcomp.result import Answer
from ffcomp.serve import machines, messages
from ffcomp.serve.commands import KINDS, PANEL, PICTURE, REPORT, Step, steps, task_of
from ffcomp.serve.jobs import CANCELLED, DONE, ENDED, FAILED, QUEUED, RUNNING, Job, JobFolder
from ffcomp.serve.messages import answer_of, keep_first_figure
from ffcomp.serve.settings import MEGABYTE, RESERVE, ServeSettings
from ffcomp.serve.uploads import Refused

COMMAND = (sys.executable, "-m", "ffcomp")
LOOK_EVERY_S = 0.2  # at a process and its log
PATIENCE_S = 5.0  # between asking a process to end and killing it
CLEAN_EVERY_S = 3600.0
STOPPED = "The server was stopped while this ran. Nothing was changed: start it again."
NICENESS = 10  # on a printer's computer the printer comes first
OOM_SCORE = "800"  # of Linux, -1000 (never) to 1000 (first)
MOST_JOBS = 500


class Runner:
    """All jobs of one server; safe to use from several threads."""

    def __init__(self, settings: ServeSettings) -> None:
        self.settings = settings
        self.kept = JobFolder(settings.folder / "jobs")
        self._changed = threading.Condition()
        self._jobs: dict[str, Job] = {}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._stopping = False
        self._threads: list[threading.Thread] = []
        self._cleaned = time.monotonic()

    def start(self) -> None:
        """Restore the jobs on disk: waiting ones wait again, running ones have failed."""
        for job in self.kept.read_all():
            if job.state == RUNNING:
                _end_left_over(job.pid, str(self.kept.place(job.id)))
                job = replace(job, state=FAILED, error=STOPPED, ended=time.time(), share=None, doing="", pid=0)
                self.kept.write(job)
            self._jobs[job.id] = job
        self.clean()
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(self.settings.jobs)]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End every process, and wait for the threads; what ran has then failed, what waited waits."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
            running = list(self._processes.values())
        for process in running:
            _end(process)
        for thread in self._threads:
            thread.join(2 * PATIENCE_S)

    # -- what the page asks --

    def all(self) -> list[Job]:
        """Every job, the newest first."""
        with self._changed:
            return sorted(self._jobs.values(), key=lambda job: job.created, reverse=True)

    def find(self, id_: str) -> Job:
        """Return a job; Refused if there is none of this name."""
        with self._changed:
            if id_ not in self._jobs:
                raise Refused(404, "There is no such job.")
            return self._jobs[id_]

    def add(self, job: Job, place_files: Callable[[Path], None]) -> Job:
        """Queue a job; `place_files` puts its input files into the folder that it is given."""
        if len(self._jobs) >= MOST_JOBS:
            raise Refused(429, f"There are {MOST_JOBS} jobs already: remove some that are done.")
        place = self.kept.place(job.id)
        try:
            (place / "in").mkdir(parents=True)
            place_files(place / "in")
            job = replace(job, created=time.time(), state=QUEUED)
            self.kept.write(job)
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise
        with self._changed:
            self._jobs[job.id] = job
            self._changed.notify()
        return job

    def again(self, id_: str) -> Job:
        """Queue a job that has ended once more, with the same files and options."""
        with self._changed:
            job = self.find(id_)
            if job.state not in ENDED:
                raise Refused(409, "It has not ended yet.")
            job = replace(
                job, state=QUEUED, error="", answer=Answer(), kept="", outputs=(), started=0.0, ended=0.0, share=None
            )
            self._keep(job)
            self._changed.notify()
        return job

    def cancel(self, id_: str) -> Job:
        """End a job that waits or runs."""
        with self._changed:
            job = self.find(id_)
            if job.state in ENDED:
                return job
            job = replace(job, state=CANCELLED, ended=time.time(), share=None, doing="", pid=0)
            self._keep(job)
            process = self._processes.get(id_)
        if process is not None:
            _end(process)
        return job

    def remove(self, id_: str) -> None:
        """Remove a job that has ended, and all its files."""
        with self._changed:
            if self.find(id_).state not in ENDED or id_ in self._processes:
                raise Refused(409, "It has not ended yet: cancel it first.")
            del self._jobs[id_]
        self.kept.remove(id_)

    def clean(self) -> None:
        """Remove jobs that ended long ago."""
        oldest = time.time() - 86400.0 * self.settings.keep_days
        for job in self.all():
            if job.state in ENDED and job.ended < oldest:
                with suppress(Refused):
                    self.remove(job.id)

    # -- the threads --

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                self._run(job)
            except Exception as error:  # whatever becomes of a job, its thread goes on to the next one
                self._end_job(job.id, FAILED, error=_sentence(error))
            finally:
                with self._changed:
                    self._processes.pop(job.id, None)

    def _next(self) -> Job | None:
        """Wait for a job and take it; None to end."""
        while True:
            with self._changed:
                if self._stopping:
                    return None
                waiting = [job for job in self._jobs.values() if job.state == QUEUED]
                if waiting:
                    job = replace(min(waiting, key=lambda each: each.created), state=RUNNING, started=time.time())
                    self._keep(job)
                    return job
                self._changed.wait(CLEAN_EVERY_S)
            if time.monotonic() - self._cleaned > CLEAN_EVERY_S:
                self._cleaned = time.monotonic()
                self.clean()

    def _run(self, job: Job) -> None:
        place = self.kept.place(job.id)
        if shutil.disk_usage(place).free < RESERVE:
            raise Refused(507, f"Less than {RESERVE // MEGABYTE} MB are free on the disk: remove work that is done.")
        shutil.rmtree(place / "out", ignore_errors=True)
        (place / "out").mkdir()
        (place / "log.txt").unlink(missing_ok=True)
        machine = str(machines.path_of(job.machine)) if job.machine else ""
        inputs = tuple(place / "in" / name for name in job.inputs)
        todo = steps(job.kind, task_of(job.kind, job.options, machine, inputs, place / "out"))
        notes: list[str] = []
        for number, step in enumerate(todo):
            code = self._step(job.id, step, place, number)
            if self.find(job.id).state != RUNNING:
                return
            if code != 0:
                why = STOPPED if self._stopping else _why(code, place)
                if step.needed:
                    self._end_job(job.id, FAILED, error=why, answer=_answer(job.kind, place))
                    return
                notes.append(f"{step.doing} failed: {why}")
        keep_first_figure(*(place / "out" / name for name in (REPORT, PICTURE, PANEL)))
        answer = _answer(job.kind, place)
        self._end_job(job.id, DONE, answer=replace(answer, warnings=[*answer.warnings, *notes]))

    def _step(self, id_: str, step: Step, place: Path, number: int) -> int:
        """Run one process to its end, and return its exit code."""
        doing = step.doing
        events = place / f"{number}.events"
        events.unlink(missing_ok=True)
        with open(place / f"{number}.json", "wb") as out, open(place / "log.txt", "ab") as log:
            with self._changed:
                if self._jobs[id_].state != RUNNING or self._stopping:
                    return 1
                process = subprocess.Popen(
                    [*COMMAND, *step.words],
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=log,
                    cwd=place / "out",
                    env=_environment(events),
                    start_new_session=True,
                )
                self._processes[id_] = process
                self._keep(replace(self._jobs[id_], pid=process.pid, doing=doing, share=None))
            _be_nice(process.pid)
            while process.poll() is None:
                share, now = messages.progress(events, doing)
                now = messages.without_folder(now, place)
                with self._changed:
                    if self._jobs[id_].state == RUNNING:
                        self._jobs[id_] = replace(self._jobs[id_], share=share, doing=now)
                with suppress(subprocess.TimeoutExpired):
                    process.wait(LOOK_EVERY_S)
        return process.returncode

    def _end_job(self, id_: str, state: str, error: str = "", answer: Answer | None = None) -> None:
        place = self.kept.place(id_)
        outputs = tuple(sorted(path.name for path in (place / "out").glob("*") if path.is_file()))
        with self._changed:
            job = self._jobs[id_]
            if job.state != RUNNING:
                return
            job = replace(job, state=state, error=error, answer=answer or Answer(), outputs=outputs, ended=time.time())
            job = replace(job, share=None, doing="", pid=0)
        if state == DONE:
            job = machines.kept_if_imported(job, place)
        with self._changed:
            self._keep(job)

    def _keep(self, job: Job) -> None:
        """Keep a job; where the disk is full, at least until the server stops."""
        self._jobs[job.id] = job
        with suppress(OSError):
            self.kept.write(job)


def _sentence(error: Exception) -> str:
    if isinstance(error, Refused):
        return error.sentence
    if isinstance(error, OSError):
        return f"{error.strerror or error}: {error.filename or 'a file'}."
    return f"Internal error: {error!r}."


def _why(code: int, place: Path) -> str:
    """Say why a process failed; on a full disk it could not even write that down."""
    if shutil.disk_usage(place).free < messages.TAIL:
        return "The disk is full: remove work that is done, and try again."
    return messages.why_failed(code, messages.log_end(place))


def _answer(kind: str, place: Path) -> Answer:
    """Read what the first step printed; empty where that is no JSON."""
    with suppress(OSError, ValueError, LookupError, TypeError, AttributeError):
        result = json.loads((place / "0.json").read_text(encoding="utf-8").splitlines()[-1])
        text = json.dumps(asdict(answer_of(result, KINDS[kind].form)), ensure_ascii=False)
        return Answer(**json.loads(messages.without_folder(text, place)))
    return Answer()


def _environment(events: Path) -> dict[str, str]:
    """Return a process's environment, with the file for its events and without a slicer's variables."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SLIC3R_PP")}
    return kept | {"COLUMNS": "200", "PYTHONUNBUFFERED": "1", "FFCOMP_EVENTS": str(events)}


def _be_nice(pid: int) -> None:
    """Lower the priority, and let this process be the first to end when memory runs out."""
    with suppress(OSError, AttributeError):  # Windows has no such function
        os.setpriority(os.PRIO_PROCESS, pid, NICENESS)
    with suppress(OSError):
        Path(f"/proc/{pid}/oom_score_adj").write_text(OOM_SCORE, encoding="ascii")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ask a process and its children to end, and kill them if they do not."""
    for number in (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM)):
        if process.poll() is not None:
            return
        _signal(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE_S)


def _signal(pid: int, number: int) -> None:
    with suppress(OSError):
        getattr(os, "killpg", os.kill)(pid, number)  # Windows has no groups


def _end_left_over(pid: int, place: str) -> None:
    """End the process of a server that is gone, if it is still this job's: process numbers are reused."""
    with suppress(OSError):
        if pid > 0 and place.encode() in Path(f"/proc/{pid}/cmdline").read_bytes():
            _signal(pid, signal.SIGTERM)
