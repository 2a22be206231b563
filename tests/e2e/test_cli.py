"""The command line as a user meets it: files, exit codes, one sentence on stderr, nothing lost."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ffcomp.cli.app import app
from ffcomp.steps.archive import read_steps
from gcode.atomic_write import drafts_noted, replaced_since, replacing
from gcode.embedded import TIME_WAS, WITHOUT_ORIGINAL
from models.file import load_machine
from tests.support.cli import PLAIN, CliRunner, Result, ffcomp
from tests.support.prints import squares
from tests.support.steps import read_events

ROOT = Path(__file__).parents[2]
SMALL = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n;LAYER:0\nG1 X30 Y12 E1\nG1 X28 Y30 E1\nM107\n"


def as_a_process(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from ffcomp.cli.app import main; main()", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **PLAIN}
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, timeout=120, check=False)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "ein Würfel 立方.gcode"
    path.write_bytes(SMALL)
    return path


def test_the_main_job_and_the_way_back(small: Path) -> None:
    small.chmod(0o640)
    first = as_a_process("compensate", "--machine", "mp-delta-pro", small)
    assert first.returncode == 0, first.stderr
    out = small.read_bytes()
    assert out != SMALL and "xpected contour error" in first.stdout and "xpected" not in first.stderr
    second = ffcomp("compensate", "--machine", "mp-delta-pro", small)
    assert second.exit_code == 0 and "already processed" in second.stdout
    assert small.read_bytes() == out and stat.S_IMODE(small.stat().st_mode) == 0o640
    copies = small.with_name("copies")
    third = ffcomp("compensate", "-m", "mp-delta-pro", small, "-o", small.with_name("copy.gcode"), "--json")
    assert json.loads(third.stdout)["output"] == str(small.with_name("copy.gcode"))
    assert ffcomp("compensate", "-m", "mp-delta-pro", small, "--output-dir", copies).exit_code == 0
    assert small.with_name("copy.gcode").read_bytes() == (copies / small.name).read_bytes() == out
    again = ffcomp("compensate", "--machine", "mp-delta-pro", "--force", "-q", small)
    assert again.exit_code == 0 and small.read_bytes() == out
    shown = ffcomp("show", small)
    assert shown.exit_code == 0, shown.stderr
    assert "xpected contour error with modes known to ±6.1 %" in shown.stdout and "times less" in shown.stdout
    assert small.with_name(f"{small.name}.png").read_bytes().startswith(b"\x89PNG")
    refused = ffcomp("show", small, "-o", "picture.gcode")
    assert refused.exit_code == 2 and "picture.gcode: the name of a figure ends in .png, .svg, .pdf" in refused.stderr
    assert ffcomp("restore", small).exit_code == 0
    assert small.read_bytes() == SMALL


def test_a_dry_run_writes_nothing(small: Path) -> None:
    answer = ffcomp("compensate", "-m", "mp-delta-pro", small, "--dry-run", "--json")
    assert json.loads(answer.stdout)["output"] is None
    assert small.read_bytes() == SMALL and [p.name for p in small.parent.iterdir()] == [small.name]


MACHINE = "mp-delta-pro"


@pytest.fixture
def printed(tmp_path: Path) -> Path:
    path = tmp_path / "squares.gcode"
    path.write_bytes(squares(1))
    return path


def call(*words: str | Path) -> Result:
    return CliRunner().invoke(app, ["compensate", *map(str, words)])


def weak(tmp_path: Path, limit: str) -> Path:
    """The library's machine with one limit more."""
    text = Path(load_machine(MACHINE).path).read_text(encoding="utf-8")
    path = tmp_path / "weak.toml"
    path.write_text(text.replace("[limits]\n", f"[limits]\n{limit}\n"), encoding="utf-8")
    return path


def test_without_its_original_a_file_is_smaller_and_says_so(printed: Path, tmp_path: Path) -> None:
    """The same segments at the same times, no comment that keeps a move, and a sentence wherever one is needed."""
    whole, small = tmp_path / "whole.gcode", tmp_path / "small.gcode"
    words = (printed, "-m", MACHINE, "-o")
    said = call(*words, whole, "--json", "-q"), call(*words, small, "--no-embed")
    results = [json.loads(said[0].stdout)["original_embedded"], "keep the sliced one" in said[1].output]
    assert results == [True, True] and "keep the sliced one" not in said[0].output
    kept, left = (path.read_bytes().splitlines(keepends=True) for path in (whole, small))
    assert any(line.startswith(b";~") for line in kept) and not any(line.startswith(b";~") for line in left)
    assert [line for line in kept if not line.startswith((b";~", TIME_WAS))] == [
        line for line in left if not line.startswith(WITHOUT_ORIGINAL)
    ]
    before = small.read_bytes()
    for verb in (["restore"], ["show"], ["compensate", "--force", "-m", MACHINE], ["compare", "-m", MACHINE]):
        done = CliRunner().invoke(app, [*verb, str(small)])
        assert done.exit_code == 4 and "--no-embed" in done.output, (verb, done.output)
        assert small.read_bytes() == before
    timed = CliRunner().invoke(app, ["estimate", str(small), "-m", MACHINE, "--json"])
    assert timed.exit_code == 0, timed.output


@pytest.mark.parametrize(("kind", "rows"), [("steps", False), ("klipper-steps", True)])
def test_step_timings_beside_the_print(printed: Path, kind: str, rows: bool) -> None:
    before = printed.read_bytes()
    done = call(printed, "-m", MACHINE, "--kind", kind, "--extruder-steps-per-mm", "400", "--json", "-q")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    archive = printed.with_suffix(".npz")
    assert result["output"] == str(archive) and printed.read_bytes() == before
    motors = read_steps(archive)
    assert {name: total["steps"] for name, total in result["steps"].items()} == {
        name: len(motor.time_s) for name, motor in motors.items()
    }
    assert (result["steps"]["a"]["rows"] > 0) == rows
    assert len(read_events(archive)[1]) > 3
    judged = CliRunner().invoke(app, ["simulate", str(archive), "-m", MACHINE, "--json", "-q"])
    assert judged.exit_code == 0, judged.output


def test_a_limit_slows_down_or_stops(printed: Path, tmp_path: Path) -> None:
    machine = weak(tmp_path, "step_rate_hz = 4000.0")  # 50 mm/s of a carriage
    before = printed.read_bytes()
    refused = call(printed, "-m", machine, "--strict", "-q")
    assert refused.exit_code == 6 and "would have to be slowed" in refused.output
    assert printed.read_bytes() == before
    slowed = call(printed, "-m", machine, "--json", "-q")
    assert slowed.exit_code == 0, slowed.output
    result = json.loads(slowed.stdout)
    assert result["slowed"] and result["slowed"][0]["limit"] == "velocity"
    assert any("Slowed at" in sentence and "velocity" in sentence for sentence in result["warnings"])
    assert result["print_time_s"] > 1.05 * result["original_print_time_s"]


# ---- interrupt ----


def interrupted(
    monkeypatch: pytest.MonkeyPatch, owner: object, name: str, *, after: bool, wrapped: bool = False
) -> None:
    """Let Ctrl-C come just before or just after a function has done its work, or wrapped as compiled code does."""
    function: Any = getattr(owner, name)

    def with_interrupt(*args: Any, **options: Any) -> Any:
        mine = name != "replace" or str(args[1]).endswith(".gcode")  # the cache of tables is none of the user's files
        if after or not mine:
            function(*args, **options)
        if mine and wrapped:
            raise SystemError("a result with an exception set") from KeyboardInterrupt()
        if mine:
            raise KeyboardInterrupt

    monkeypatch.setattr(owner, name, with_interrupt)


@pytest.mark.parametrize("wrapped", [False, True], ids=["in Python", "in compiled code"])
def test_before_the_file_takes_its_place(printed: Path, monkeypatch: pytest.MonkeyPatch, wrapped: bool) -> None:
    before = printed.read_bytes()
    interrupted(monkeypatch, os, "replace", after=False, wrapped=wrapped)
    call = CliRunner().invoke(app, ["compensate", str(printed), "-m", MACHINE, "--no-predict"])
    assert call.exit_code == 130 and "Interrupted; no file was changed." in call.output
    assert printed.read_bytes() == before and [path.name for path in printed.parent.iterdir()] == [printed.name]


@pytest.mark.parametrize("moment", ["the rename", "the report"])
def test_after_the_file_has_taken_its_place(printed: Path, monkeypatch: pytest.MonkeyPatch, moment: str) -> None:
    """The line of 100 % comes before; whoever interrupts then has a compensated file, and is told."""
    before = printed.read_bytes()
    if moment == "the rename":
        interrupted(monkeypatch, os, "replace", after=True)
    else:
        from ffcomp.cli import command

        interrupted(monkeypatch, command, "answer", after=False)
    call = CliRunner().invoke(app, ["compensate", str(printed), "-m", MACHINE, "--no-predict"])
    assert call.exit_code == 130 and "no file was changed" not in call.output
    assert f"Interrupted; {printed} had been written before, and is complete." in call.output
    assert printed.read_bytes() != before and b"Processed by ffcomp" in printed.read_bytes()
    monkeypatch.undo()
    assert CliRunner().invoke(app, ["restore", str(printed)]).exit_code == 0 and printed.read_bytes() == before


def test_what_is_in_place_is_known_from_the_file_itself(tmp_path: Path) -> None:
    target, noted = tmp_path / "a", drafts_noted()
    with replacing(target) as file:
        file.write(b"1")
        assert replaced_since(noted) == []
    assert replaced_since(noted) == [str(target)]
    target.unlink()
    target.write_bytes(b"another's")
    os.utime(target)
    assert replaced_since(drafts_noted()) == []
