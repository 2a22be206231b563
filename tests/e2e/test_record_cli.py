"""`ffcomp record` as an owner calls it."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.cli.app import app
from tests.support.cli import CliRunner, Result


def ffcomp(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def moves(folder: Path, *more: str) -> tuple[Path, Path]:
    target = folder / "moves.gcode"
    done = ffcomp("record", "plan", "-m", "ender-3", "-o", target, "--seconds", "2", "--at", "110,110", *more)
    assert done.exit_code == 0, done.output
    return target, folder / "moves.json"


@pytest.mark.parametrize("flavor", ["klipper", "reprapfirmware"])
def test_captures_of_the_virtual_printer_are_joined(flavor: str, tmp_path: Path) -> None:
    target, plan = moves(tmp_path, "--repeats", "1")
    folder = tmp_path / "captures"
    rate = "3200" if flavor == "klipper" else "1344"
    played = ("simulate", target, "-m", "ender-3", "--as-captures", folder, "--plan", plan, "--rate", rate)
    done = ffcomp(*played, "--flavor", flavor, "-q", "--seed", "4")
    assert done.exit_code == 0, done.output
    captures = sorted(folder.glob("*.csv"))
    assert len(captures) == 4
    done = ffcomp("record", "join", *captures, "--plan", plan, "-m", "ender-3", "--output-dir", tmp_path / "runs", "-q")
    assert done.exit_code == 0 and "4 of 4 executions joined" in done.output, done.output


def test_a_damaged_history_stays_as_it_is(tmp_path: Path) -> None:
    planned = ffcomp("record", "plan", "--for", "check", "-m", "ender-3", "-o", tmp_path / "check.gcode")
    assert planned.exit_code == 0
    history = tmp_path / "checks.jsonl"
    history.write_text('{"schema":"ffcomp-check', encoding="utf-8")
    call = ("record", "check", "a.csv", "--plan", tmp_path / "check.json", "-m", "ender-3", "--history", history)
    done = ffcomp(*call)
    assert done.exit_code == 5 and "Line 1 of the history is no check of ffcomp" in done.output, done.output
    assert history.read_text(encoding="utf-8") == '{"schema":"ffcomp-check'
