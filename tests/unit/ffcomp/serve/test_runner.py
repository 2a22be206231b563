"""Jobs that run: watched, cancelled, killed, started again with the server; with a stand-in for `python -m ffcomp`."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from ffcomp.serve.jobs import CANCELLED, DONE, ENDED, FAILED, QUEUED, RUNNING, Job, JobFolder
from ffcomp.serve.runner import Runner
from ffcomp.serve.settings import ServeSettings
from ffcomp.serve.uploads import Refused, new_id

STAND_IN = """
import json, os, sys, time
words = sys.argv[1:]
if words[0] == "show":
    sys.exit("ffcomp: Figures and pages need Matplotlib.")
source, target = words[1], words[words.index("-o") + 1]
what = open(source).read()
if "Gcode" in what: print(f"ffcomp: {source}: line 3: it cannot be.", file=sys.stderr); sys.exit(4)
if "crash" in what: raise RuntimeError("a bug")
def tell(stage):
    with open(os.environ["FFCOMP_EVENTS"], "a") as file:
        file.write(json.dumps({"stage": stage, "share": 0.4, "left_s": 7.0}) + chr(10))
tell("compensating")
if "slow" in what: time.sleep(60)
if "stubborn" in what:
    import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); tell("deaf")
    time.sleep(60)
open(target, "w").write("; compensated")
answer = {"headline": "It is done.", "facts": [["Print time", "1m 0s"]], "warnings": [], "next_steps": []}
print(json.dumps({"answer": answer, "niceness": os.nice(0)}))
"""


@pytest.fixture(autouse=True)
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "stand_in.py"
    script.write_text(STAND_IN, encoding="utf-8")
    monkeypatch.setattr("ffcomp.serve.runner.COMMAND", (sys.executable, "-S", str(script)))


@contextmanager
def runner(folder: Path, jobs: int = 1) -> Iterator[Runner]:
    made = Runner(ServeSettings(folder / "work", jobs=jobs))
    made.start()
    yield made
    made.stop()


def add(to: Runner, text: str) -> str:
    job = Job(new_id(), "compensate", "a.gcode", "kossel", ("a.gcode",))
    to.add(job, lambda place: (place / "a.gcode").write_text(text) and None)
    return job.id


def until(holds: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def ended(of: Runner, id_: str) -> Job:
    until(lambda: of.find(id_).state in ENDED)
    return of.find(id_)


def running(of: Runner, id_: str, said: str = "s left") -> Job:
    until(lambda: of.find(id_).state == RUNNING and said in of.find(id_).doing)
    return of.find(id_)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    return True


def test_a_job_ends_with_its_files_and_answer(tmp_path: Path) -> None:
    with runner(tmp_path) as made:
        job = ended(made, add(made, "G28"))
        assert job.state == DONE and job.outputs == ("a.gcode",) and job.error == ""
        assert ["Print time", "1m 0s"] in job.answer.facts
        assert job.answer.warnings == ["drawing failed: Figures and pages need Matplotlib."]
        printed = json.loads((made.kept.place(job.id) / "0.json").read_text())
        assert printed["niceness"] >= 0  # set from outside, a moment after it has started


def test_progress_is_seen_while_it_runs_and_cancel_ends_the_process(tmp_path: Path) -> None:
    with runner(tmp_path) as made:
        id_ = add(made, "slow")
        job = running(made, id_)
        assert job.share == 0.4 and job.doing == "compensating, about 5 s left"
        assert made.cancel(id_).state == CANCELLED
        until(lambda: not alive(job.pid))
        assert ended(made, id_).state == CANCELLED
        until(lambda: _removed(made, id_))
        assert not (tmp_path / "work" / "jobs" / id_).exists()


def _removed(of: Runner, id_: str) -> bool:
    try:
        of.remove(id_)
    except Refused:
        return False
    return True


def test_what_does_not_end_when_asked_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ffcomp.serve.runner.PATIENCE_S", 0.2)
    with runner(tmp_path) as made:
        id_ = add(made, "stubborn")
        pid = running(made, id_, "deaf").pid
        made.cancel(id_)
        until(lambda: not alive(pid))


def test_a_worker_that_is_killed_is_a_sentence_and_the_next_job_runs(tmp_path: Path) -> None:
    with runner(tmp_path) as made:
        first, second = add(made, "slow"), add(made, "G28")
        os.killpg(running(made, first).pid, signal.SIGKILL)
        job = ended(made, first)
        assert job.state == FAILED and "was killed (signal 9)" in job.error
        assert ended(made, second).state == DONE
        assert made.again(first).state == QUEUED
        running(made, first)


def test_no_more_run_at_a_time_than_allowed(tmp_path: Path) -> None:
    with runner(tmp_path, jobs=2) as made:
        ids = [add(made, "slow") for _ in range(5)]
        until(lambda: sum(made.find(each).state == RUNNING for each in ids) == 2)
        time.sleep(0.1)
        assert [made.find(each).state for each in ids] == [RUNNING, RUNNING, QUEUED, QUEUED, QUEUED]
        made.cancel(ids[3])
        assert made.find(ids[3]).state == CANCELLED  # without ever running


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="only Linux tells what a process is")
def test_a_process_that_a_killed_server_left_is_ended(tmp_path: Path) -> None:
    with runner(tmp_path) as made:
        job = running(made, add(made, "slow"))
        second = Runner(made.settings)  # a server that was killed has ended nothing
        second.start()
        until(lambda: not alive(job.pid))
        assert second.find(job.id).state == FAILED
        second.stop()


def test_a_job_that_was_cut_off_while_it_was_made_is_removed(tmp_path: Path) -> None:
    folder = JobFolder(tmp_path)
    for k, text in enumerate(["", "{", "[]", '{"id": 1}']):
        (tmp_path / f"{k:016x}").mkdir()
        (tmp_path / f"{k:016x}" / "job.json").write_text(text)
    (tmp_path / "notes").mkdir()  # somebody else's
    assert list(folder.read_all()) == [] and [path.name for path in tmp_path.glob("[0n]*")] == ["notes"]


def test_old_work_is_removed(tmp_path: Path) -> None:
    with runner(tmp_path) as made:
        old, new = ended(made, add(made, "G28")), ended(made, add(made, "G28"))
        until(lambda: not made._processes)
        made.kept.write(replace(old, ended=time.time() - 15 * 86400.0))
    with runner(tmp_path) as made:
        assert [job.id for job in made.all()] == [new.id]
        assert not made.kept.place(old.id).exists()


def test_a_full_disk_is_the_jobs_trouble(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with runner(tmp_path) as made:
        usage = shutil.disk_usage(tmp_path)
        monkeypatch.setattr("shutil.disk_usage", lambda path: usage._replace(free=1000))
        job = ended(made, add(made, "G28"))
        assert job.state == FAILED and "MB are free on the disk" in job.error
        monkeypatch.undo()
