"""The command line as a user meets it: files, exit codes, one sentence on stderr, nothing lost."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.cli import PLAIN, ffcomp

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
