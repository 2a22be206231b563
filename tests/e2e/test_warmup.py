"""`ffcomp warmup`, and what a first run says."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.cli.app import app
from tests.support.cli import CliRunner
from tests.support.docs_runner import ROOT

COMPENSATE = ["compensate", str(ROOT / "docs" / "examples" / "wiggle.gcode"), "-m", "kossel"]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FFCOMP_CACHE", str(tmp_path / "cache"))


def test_the_first_run_says_that_it_compiles(tmp_path: Path) -> None:
    said = [CliRunner().invoke(app, [*COMPENSATE, "-o", str(tmp_path / f"{k}.gcode")]).output for k in range(2)]
    assert ["Compiling once" in text for text in said] == [True, False]


def test_after_warming_up_no_run_compiles(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["warmup"])
    assert result.exit_code == 0, result.output
    assert (
        "[8/8] simulate" in result.output
        and "compensate --robust on, straight axes" in result.output
        and "Ready after" in result.output
    )
    after = CliRunner().invoke(app, [*COMPENSATE, "-o", str(tmp_path / "out.gcode")])
    assert after.exit_code == 0 and "Compiling" not in after.output
