"""`ffcomp machines import`: what goes where, and with which exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ffcomp.cli.machines import machines as app
from models.file import load_machine
from tests.support.cli import CliRunner, Result
from tests.support.configs import Delta, written


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("models.finding.user_folder", lambda: tmp_path / "own")
    return tmp_path / "own"


@pytest.fixture
def run(own_folder: Path):
    def run(*arguments: str | Path) -> Result:
        return CliRunner().invoke(app, ["import", *map(str, arguments)])

    return run


def test_a_delta_becomes_a_machine_that_checks_well(run, own_folder: Path, tmp_path: Path) -> None:
    result = run(written(tmp_path, Delta().klipper(), "printer.cfg"))
    assert result.exit_code == 0, result.output
    for source in ("read: ", "converted: ", "assumed: "):
        assert source in result.stdout
    row = next(line for line in result.stdout.splitlines() if "kinematics.arm_lengths_mm" in line)
    assert "280.5, 280.75, 280.25" in row and "printer.cfg:4 [stepper_a] arm_length" in row
    assert load_machine(own_folder / "printer.toml").name == "printer"
    checked = CliRunner().invoke(app, ["check", str(own_folder / "printer.toml")])
    assert checked.exit_code == 0
    assert "Not measured: carriage.mass_kg" in checked.stdout


def test_marlin_is_told_its_kinematics(run, tmp_path: Path) -> None:
    log = "echo:  M92 X80 Y80 Z400\necho:  M203 X300 Y300 Z10\necho:  M201 Z100\necho:  M593 F40 D0.1\n"
    result = run(written(tmp_path, log), "-o", tmp_path / "a.toml")
    assert result.exit_code == 5
    assert "--kinematics cartesian" in result.stderr
    assert run(written(tmp_path, log), "-o", tmp_path / "a.toml", "--kinematics", "polar").exit_code == 2
    result = run(written(tmp_path, log), "-o", tmp_path / "a.toml", "--kinematics", "corexy", "--json")
    assert json.loads(result.stdout)["missing"].keys() == {
        *(f"kinematics.{axis}_range_mm" for axis in "xyz"),
        "limits.acceleration_mm_per_s2",
    }


M503 = "M92 X80 Y80 Z400 E93\nM201 X500 Y500 Z100 E5000\nM203 X500 Y500 Z5 E25\nM204 P500 R500 T500\nM205 J0.08\n"


def test_an_incomplete_import_is_completed_by_the_same_command_with_a_like_machine(run, tmp_path: Path) -> None:
    source, path = written(tmp_path, M503, "m503.txt"), tmp_path / "mine.toml"
    words = (source, "-o", path, "--kinematics", "cartesian")
    first = run(*words)
    assert first.exit_code == 5 and "--like ender-3" in first.output and "voron" not in first.output
    assert run(*words, "--like", "ender-3").exit_code == 0
    machine = load_machine(str(path))
    assert machine.kinematics.range_mm.tolist() == load_machine("ender-3").kinematics.range_mm.tolist()
    assert machine.limits.carriage_acceleration_mm_per_s2 == 5000.0, "no motor was asked for 30 m/s² where M201 is 0.5"
    again = run(*words, "--like", "ender-3")
    assert again.exit_code == 2 and "exists already" in again.output, "a complete file is never overwritten"
