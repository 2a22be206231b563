"""Many files at once: on one process, several, or a cluster, the same bytes; what fails, fails alone."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

import pytest

from ffcomp.compensation.batch import compensate_files, workers
from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.result import Failure, FileResult
from models.machine import Machine
from tests.support.cli import Result, ffcomp
from tests.support.compensated import plainly

ROOT = Path(__file__).parents[2]
HEAD = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n"
BAD = HEAD + b"G1 X400\n"
MAIN = "from ffcomp.cli.app import main; main()"


def a_print(size: int) -> bytes:
    """A few moves, no two prints alike."""
    return HEAD + b"".join(b"G1 X%d Y%d E.5\nG1 X%d E.5\nG0 X10 Y10\n" % (k, 2 * k, k % 7) for k in range(size))


def compensate(*arguments: str | Path, cwd: Path | None = None) -> Result:
    return ffcomp("compensate", "-m", "mp-delta-pro", "--robust", "off", "--no-predict", *arguments, cwd=cwd)


def written(folder: Path) -> list[Path]:
    """The smallest first: the order in which they are given is not that in which they are done."""
    paths = [folder / "ein Würfel.gcode", folder / "b.gcode", folder / "c.gcode"]
    for size, path in enumerate(paths, start=3):
        path.write_bytes(a_print(size))
    return paths


@pytest.fixture
def prints(tmp_path: Path) -> list[Path]:
    return written(tmp_path)


@pytest.fixture(scope="module")
def alone(machine: Machine, tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """What a single process makes of each."""
    paths = written(tmp_path_factory.mktemp("alone"))
    done = in_order(compensate_files(paths, paths, machine, plainly(predict=False)))
    assert [outcome.failure for outcome in done] == [None] * 3
    return [path.read_bytes() for path in paths]


def in_order(outcomes: Iterator[FileResult]) -> list[FileResult]:
    return sorted(outcomes, key=lambda outcome: outcome.number)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_side_by_side_in_place(prints: list[Path], alone: list[bytes], tmp_path: Path) -> None:
    bad, missing = tmp_path / "bad.gcode", tmp_path / "missing.gcode"
    bad.write_bytes(BAD)
    before = names(tmp_path)
    first = compensate(prints[0], bad, prints[1], missing, prints[2], "--jobs", "2", "--json")
    assert first.exit_code == 4, first.stderr  # of the first that failed, though the missing one may fail before it
    answer = json.loads(first.stdout)
    assert answer["schema"] == "ffcomp-compensate-batch/1" and answer["failed"] == 2
    results = answer["results"]
    assert [Path(result["input"]).name for result in results] == [
        "ein Würfel.gcode",
        "bad.gcode",
        "b.gcode",
        "missing.gcode",
        "c.gcode",
    ]
    assert [result.get("exit_code") for result in results] == [None, 4, None, 2, None]
    assert f"{bad}:6:" in results[1]["error"] and "Traceback" not in first.stderr
    assert results[2]["schema"] == "ffcomp-compensate/1" and results[2]["output"] == str(prints[1])
    assert [path.read_bytes() for path in prints] == alone
    assert bad.read_bytes() == BAD and names(tmp_path) == before
    rows = [f"{name} {value}" for name, value in answer["answer"]["facts"]]
    assert all(name in row for name, row in zip(("Würfel", "bad", "b.g", "missing", "c.g"), rows, strict=True))
    assert "failed" in rows[1] and str(missing) in first.stderr.splitlines()[-1]
    again = compensate(*prints, "-q")
    assert again.exit_code == 0 and again.stderr == ""
    assert [path.read_bytes() for path in prints] == alone


class Poisoned(type(Path())):  # type: ignore[misc]
    """A file that ends the other process that reads it, or finds a fault in ffcomp there."""

    raised = False  # by this task: a cluster may ask a second one of the same process

    def __str__(self) -> str:
        if parent_process() is not None and not self.raised:
            if "poison" in self.name:
                os._exit(1)
            self.raised = True
            raise ZeroDivisionError("of ours")
        return str(super().__str__())


def poisoned(prints: list[Path], machine: Machine, **where: Any) -> list[FileResult]:
    """All of them in place, one of which is poison and one a fault."""
    poison, fault = (Poisoned(prints[0].with_name(name)) for name in ("poison.gcode", "fault.gcode"))
    files = [prints[0], poison, fault, *prints[1:]]
    for file in (poison, fault):
        file.write_bytes(a_print(6))
    outcomes = in_order(compensate_files(files, files, machine, plainly(predict=False, **where)))
    assert poison.read_bytes() == fault.read_bytes() == a_print(6)
    assert names(poison.parent) - {"far"} == {file.name for file in files}
    return outcomes


def check_poisoned(outcomes: list[FileResult]) -> None:
    failures = [outcome.failure for outcome in outcomes]
    assert failures[0] is failures[3] is failures[4] is None
    assert isinstance(failures[1], Failure) and isinstance(failures[2], Failure)
    assert failures[1].exit_code == 1 and "poison.gcode: A process" in failures[1].sentence
    assert failures[2].exit_code == 1 and "ZeroDivisionError: of ours" in failures[2].sentence
    assert "Traceback" in failures[2].trace


def test_a_process_that_dies_takes_only_its_file_along(
    prints: list[Path], alone: list[bytes], machine: Machine
) -> None:
    check_poisoned(poisoned(prints, machine, jobs=2))
    assert [path.read_bytes() for path in prints] == alone


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """The address of a cluster of two processes in which a task may not kill twice."""
    reason = "The cluster's tests need Dask: pip install 'ffcomp[dask]'."
    distributed = pytest.importorskip("distributed", reason=reason)
    dask = pytest.importorskip("dask")
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
        ) as cluster,
    ):
        yield cluster.scheduler_address


def test_on_a_cluster(prints: list[Path], alone: list[bytes], machine: Machine, scheduler: str, tmp_path: Path) -> None:
    folder = tmp_path / "far"
    answer = compensate(*prints, "--scheduler", scheduler, "--output-dir", folder, "--json")
    assert answer.exit_code == 0, answer.stderr
    assert [(folder / path.name).read_bytes() for path in prints] == alone
    (folder / "b.gcode").unlink()
    with workers(1, scheduler) as at_once:  # one file: its chunks
        compensate_file(prints[1], "b", machine, plainly(predict=False), folder / "b.gcode", jobs=at_once)
    assert (folder / "b.gcode").read_bytes() == alone[1]
    check_poisoned(poisoned(prints, machine, scheduler=scheduler))
    assert [path.read_bytes() for path in prints] == alone


def test_an_interrupt_leaves_what_is_finished(prints: list[Path], alone: list[bytes], tmp_path: Path) -> None:
    long = tmp_path / "long.gcode"
    moves = b"".join(b"G1 X%d Y%d E.1\n" % (k % 40, k * 7 % 40) for k in range(5_000))
    long.write_bytes(HEAD + moves)
    words = ("compensate", "-m", "mp-delta-pro", "--robust", "off", "--no-predict", "-j", "2")
    command = [sys.executable, "-c", MAIN, *words, prints[0], long]
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )
    for _ in range(600):
        if prints[0].read_bytes() != a_print(3):
            break
        time.sleep(0.1)
    time.sleep(0.5)  # the process that is done has yet to say so
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "Interrupted; 1 of 2 files are done" in errors, errors
    assert prints[0].read_bytes() == alone[0] and long.read_bytes() == HEAD + moves
    assert names(tmp_path) == {path.name for path in (*prints, long)}
