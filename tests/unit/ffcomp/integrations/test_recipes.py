"""Wrappers are put where programs look for them."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.cli.integrations import integrations as app
from ffcomp.integrations.recipes import cura_folders
from tests.support.cli import CliRunner


def test_install_puts_a_wrapper_where_cura_looks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platformdirs.user_data_dir", lambda *_, **__: str(tmp_path / "cura"))
    runner = CliRunner()
    nowhere = runner.invoke(app, ["install", "cura"])
    assert nowhere.exit_code == 2 and "--to DIR" in nowhere.stderr
    for version in ("5.2", "5.10", "4.13", "stash"):
        (tmp_path / "cura" / version).mkdir(parents=True)
    assert [folder.parent.name for folder in cura_folders()] == ["5.10", "5.2", "4.13"]
    answer = runner.invoke(app, ["install", "cura", "--machine", "kossel"])
    target = tmp_path / "cura" / "5.10" / "scripts" / "Ffcomp.py"
    assert answer.exit_code == 0 and answer.stdout == f"{target}\n"
    assert '\nMACHINE = "kossel"\n' in target.read_text(encoding="utf-8")
