"""`ffcomp machines`: what goes where, and with which exit code."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.cli.machines import machines as app
from models.file import LIBRARY, load_machine
from models.kinds import delta_vibration
from tests.support.cli import CliRunner, Result


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("models.finding.user_folder", lambda: tmp_path / "own")
    return tmp_path / "own"


@pytest.fixture
def run(own_folder: Path):
    def run(*arguments: str) -> Result:
        return CliRunner().invoke(app, arguments)

    return run


def test_check_of_a_model_that_does_not_hold_still(run, tmp_path: Path) -> None:
    text = (LIBRARY / "mp-delta-pro-as-printed.toml").read_text()
    path = tmp_path / "unstable.toml"
    path.write_text(text.replace("[10.21, -16.52, 19.31]", "[35.0, -60.0, 120.0]"))
    result = run("check", str(path))
    assert result.exit_code == 5
    assert "does not decay" in result.stderr


def test_new_starts_a_file_that_loads(run, own_folder: Path) -> None:
    result = run("new", "mine", "--from", "kossel")
    assert (result.exit_code, result.stdout.strip()) == (0, str(own_folder / "mine.toml"))
    machine = load_machine("mine")
    assert machine.name == "mine"
    assert delta_vibration(machine).carriage == delta_vibration(load_machine("kossel")).carriage


def test_new_stays_in_its_folder(run, own_folder: Path) -> None:
    result = run("new", "../mine")
    assert result.exit_code == 2
    assert "cannot be a machine's name" in result.stderr
