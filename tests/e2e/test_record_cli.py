"""`ffcomp record` as an owner calls it."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from ffcomp.cli.app import app
from models.file import load_machine


def ffcomp(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.parametrize("machine", ["mp-delta-pro", "voron-300"])
def test_a_plan_names_the_next_command_that_works_for_its_machine(machine: str, tmp_path: Path) -> None:
    target = tmp_path / "moves.gcode"
    done = ffcomp("record", "plan", "-m", machine, "-o", target, "--at", "0,0" if "delta" in machine else "150,150")
    assert done.exit_code == 0, done.output
    command = "ffcomp diagnose" if load_machine(machine).vibration.diagnosable else "ffcomp record join"
    assert f"Then: {command} CAPTURES --plan {tmp_path / 'moves.json'} -m {machine}" in done.output
