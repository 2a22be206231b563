"""`ffcomp warmup`, and what a run says that compiles."""

from __future__ import annotations

from importlib import import_module, reload
from pathlib import Path

import pytest

from ffcomp.cli.app import app
from models.compiled import BEFORE_COMPILING
from tests.support.cli import CliRunner
from tests.support.docs_runner import ROOT

COMPENSATE = ["compensate", str(ROOT / "docs" / "examples" / "wiggle.gcode"), "-m", "kossel"]


def test_a_run_says_once_that_it_compiles_and_only_then(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = "from models.compiled import kernel\n@kernel\ndef {0}(x):\n    return x * x\n"
    (tmp_path / "loops.py").write_text(loop.format("first") + loop.format("second"), encoding="ascii")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("FFCOMP_JIT", "1")
    CliRunner().invoke(app, [*COMPENSATE, "-o", str(tmp_path / "no folder" / "out.gcode")])
    (say,), said = BEFORE_COMPILING, list[str]()
    monkeypatch.setattr("ffcomp.cli.command.report", said.append)
    loops = import_module("loops")
    for _ in range(2):
        assert loops.first(3.0) == loops.second(3.0) == 9.0
        assert len(said) == 1 and "Compiling once" in said[0]
        BEFORE_COMPILING[:] = [say]
        loops = reload(loops)  # now the code is on disk


def test_after_warming_up_no_run_compiles(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["warmup"])
    assert result.exit_code == 0, result.output
    told = ("[9/9] simulate", "compensate --robust on, straight axes", "Ready after")
    assert all(each in result.output for each in told)
    after = CliRunner().invoke(app, [*COMPENSATE, "-o", str(tmp_path / "out.gcode")])
    assert after.exit_code == 0 and "Compiling" not in after.output
