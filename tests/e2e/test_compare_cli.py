"""`ffcomp compare` as a user meets it: the object on stdout, the page, and every mistake in one sentence."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ffcomp.cli.app import app
from tests.support.cli import CliRunner
from tests.support.prints import squares


def call(*arguments: str | Path):
    return CliRunner().invoke(app, ["compare", *map(str, arguments)], env={"COLUMNS": "80", "NO_COLOR": "1"})


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "zwei Würfel 立方.gcode"
    path.write_bytes(squares(2))
    return path


def test_the_whole_way(small: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    options = ("-m", "mp-delta-pro", "--only", "mzv", "--quality-um", "0", "--report", page)
    answer = call(small, *options, "--layers", "0", "--json")
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)
    assert found["schema"] == "ffcomp-compare/1"
    assert list(found["methods"]) == ["none", "mzv", "fbs-robust", "fbs-lpv"]
    assert found["ours"] == "fbs-robust" and found["methods"]["fbs-robust"]["label"] == "ffcomp"
    assert found["methods"]["fbs-lpv"]["contour_rms_um"] < found["methods"]["mzv"]["contour_rms_um"]
    assert small.name.split(".")[0] in page.read_text(encoding="utf-8")
    assert small.read_bytes() == squares(2)
    assert "printing with every method" in answer.stderr


def test_a_compensated_file_is_compared_as_what_it_was(small: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.gcode"
    done = CliRunner().invoke(app, ["compensate", str(small), "-m", "mp-delta-pro", "--json", "-o", str(out)])
    assert done.exit_code == 0, done.output
    options = ("-m", "mp-delta-pro", "--only", "mzv", "--quality-um", "0", "--layers", "1", "--json")
    before, after = (call(path, *options) for path in (small, out))
    assert "already compensated" in after.stdout and "already compensated" not in before.stdout
    first, second = (json.loads(each.stdout) for each in (before, after))
    assert first["methods"] == second["methods"]
    assert first["predicted"] == json.loads(done.stdout)["predicted"]  # one number, whoever says it
