"""`ffcomp compare` as a user meets it: the object on stdout, the page, and every mistake in one sentence."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ffcomp.cli.app import app
from tests.support.cli import CliRunner
from tests.support.prints import squares

ROOT = Path(__file__).parents[2]


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
    answer = call(small, *options, "--layers", "0", "--mismatch", "5%", "--seeds", "2", "--json")
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)
    assert found["schema"] == "ffcomp-compare/1"
    assert list(found["methods"]) == ["none", "mzv", "fbs-robust", "fbs-lpv"]
    assert found["ours"] == "fbs-robust" and found["methods"]["fbs-robust"]["label"] == "ffcomp"
    assert found["methods"]["fbs-lpv"]["contour_rms_um"] < found["methods"]["mzv"]["contour_rms_um"]
    assert len(found["methods"]["mzv"]["mismatch"]["contour_rms_um"]) == 2
    assert small.name.split(".")[0] in page.read_text(encoding="utf-8")
    assert small.read_bytes() == squares(2)
    assert "printing on Monte-Carlo plants" in answer.stderr


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


@pytest.mark.parametrize(
    ("text", "options", "code", "words"),
    [
        (b"G90\nG1 X0 Y0 Z1 F6000\nG1 X500 Y0\n", (), 4, "gcode:3: The point X = 500.000"),
        (b"", (), 4, "empty"),
        (b"; nothing\nM104 S0\n", (), 3, "no move"),
        (b"G90\nM83\nG1 X0 Y0 Z1 F6000\nG1 X5 E1\n", (), 3, "less than 1.5 s"),
        (squares(2), ("--layers", "7:9"), 3, "the print has 2 layers, 0 to 1"),
        (squares(2), ("--layers", "2:1"), 2, "the last must not be"),
        (squares(2), ("--layers", "a"), 2, "10:20"),
        (squares(2), ("--sample", "0"), 2, "above 0"),
        (squares(2), ("--mismatch", "50%"), 2, "30 %"),
        (squares(2), ("--mismatch", "ten"), 2, "such as 10%"),
        (squares(2), ("--only", "mzw"), 2, "mzw"),
        (squares(2), ("--jobs", "2"), 2, "--mismatch"),
        (squares(2), ("--scheduler", "tcp://host:1"), 2, "--mismatch"),
        (squares(2), ("--scheduler", "nowhere", "--mismatch", "5%"), 1, "Dask"),
        (squares(2), ("--plant", "kossel"), 5, "kinematics.arm_lengths_mm is 269"),
        (squares(2), ("--plant", "absent.toml"), 2, "absent.toml"),
        (squares(2), ("--report", "/no/such/folder/report.html"), 2, "/no/such/folder"),
    ],
)
def test_a_mistake_is_said_with_its_place_and_writes_nothing(
    tmp_path: Path, text: bytes, options: tuple[str, ...], code: int, words: str
) -> None:
    path = tmp_path / "print.gcode"
    path.write_bytes(text)
    page = () if "--report" in options else ("--report", str(tmp_path / "report.html"))
    answer = call(path, "-m", "mp-delta-pro", *page, *options)
    assert answer.exit_code == code, answer.output
    assert words in " ".join(answer.output.replace("│", " ").split())
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupt_is_quick_and_leaves_the_old_report(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text("old", encoding="utf-8")
    path = tmp_path / "print.gcode"
    path.write_bytes(squares(12))
    arguments = ["compare", str(path), "-m", "mp-delta-pro", "--report", str(page)]
    process = subprocess.Popen(
        [sys.executable, "-c", "from ffcomp.cli.app import main; main()", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert process.stderr is not None
    assert "tuning" in process.stderr.readline()
    time.sleep(0.3)
    sent = time.monotonic()
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 130
    assert time.monotonic() - sent < 20.0  # a search alone takes longer on a busy machine
    assert "Interrupted" in process.stderr.read()
    process.stderr.close()
    assert page.read_text(encoding="utf-8") == "old" and sorted(tmp_path.iterdir()) == [path, page]
