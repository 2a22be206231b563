"""The command line as a user meets it: files, exit codes, one sentence on stderr, nothing lost."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.cli import PLAIN, ffcomp

ROOT = Path(__file__).parents[2]
SMALL = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n;LAYER:0\nG1 X30 Y12 E1\nG1 X28 Y30 E1\nM107\n"
FAR = SMALL.replace(b"X", b"X1").replace(b"Y", b"Y1")  # and no layer comment, which has a Y as well


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
    first = as_a_process("compensate", "--machine", "mp-delta-pro", small)
    assert first.returncode == 0, first.stderr
    out = small.read_bytes()
    assert out != SMALL and "xpected contour error" in first.stdout and "xpected" not in first.stderr
    second = ffcomp("compensate", "--machine", "mp-delta-pro", small)
    assert second.exit_code == 0 and "already processed" in second.stdout
    assert small.read_bytes() == out
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


@pytest.mark.parametrize(
    ("content", "arguments", "code", "words"),
    [
        (None, [], 2, "No such file"),
        (b"", [], 4, "empty"),
        (b"GCDE\x01\x00", [], 4, "binary"),
        (b"PK\x03\x04zip", [], 4, "zip"),
        (b"; only comments\nM117 hello\n", [], 3, "nothing to compensate"),
        (SMALL + b"G1 X1e30\n", [], 4, ":10: "),
        (SMALL + b"G1 X400 E9\n", [], 4, ":10: "),
        (FAR, ["--offset-mm", "0,0"], 4, "--offset-mm -119,-120 brings it inside"),
        (SMALL + b"G1 X900 E9\nG1 X0 E12\n", [], 4, "no offset helps"),
        (SMALL, ["--machine", "mp-delta-por"], 5, "Did you mean"),
        (SMALL, ["--flavor", "marlyn"], 2, "marlyn"),
        (SMALL, ["--offset-mm", "1;2"], 2, "offset"),
        (SMALL, ["--kind", "stone"], 2, "stone"),
    ],
)
def test_what_is_wrong_is_said_and_the_file_untouched(
    tmp_path: Path, content: bytes | None, arguments: list[str], code: int, words: str
) -> None:
    path = tmp_path / "print.gcode"
    if content is not None:
        path.write_bytes(content)
    chosen = arguments if "--machine" in arguments else ["--machine", "mp-delta-pro", *arguments]
    answer = ffcomp("compensate", *chosen, path)
    assert answer.exit_code == code, answer.stderr
    assert words.lower() in answer.stderr.lower()
    assert "Traceback" not in answer.stderr
    assert content is None or path.read_bytes() == content
    assert sorted(p.name for p in tmp_path.iterdir()) == ([] if content is None else ["print.gcode"])


def test_a_folder_and_a_wrong_machine_file_are_sentences_too(tmp_path: Path, small: Path) -> None:
    assert ffcomp("compensate", "-m", "mp-delta-pro", tmp_path).exit_code == 2
    bad = tmp_path / "bad.toml"
    bad.write_text('format = "ffcomp-machine/1"\n')
    answer = ffcomp("compensate", "-m", bad, small)
    assert answer.exit_code == 5 and "kinematics" in answer.stderr and "Traceback" not in answer.stderr


def test_permissions_and_links_stay(tmp_path: Path, small: Path) -> None:
    small.chmod(0o640)
    link = tmp_path / "link.gcode"
    link.symlink_to(small)
    assert ffcomp("compensate", "-m", "mp-delta-pro", "-q", link).exit_code == 0
    assert link.is_symlink() and b"Processed by ffcomp" in small.read_bytes()
    assert stat.S_IMODE(small.stat().st_mode) == 0o640


def test_an_interrupt_leaves_the_file_whole(tmp_path: Path) -> None:
    path = tmp_path / "long.gcode"
    moves = b"".join(b"G1 X%d Y%d E.1\n" % (k % 40, k * 7 % 40) for k in range(20_000))
    path.write_bytes(SMALL + moves)
    process = subprocess.Popen(
        [sys.executable, "-c", "from ffcomp.cli.app import main; main()", "compensate", "-m", "mp-delta-pro", path],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )
    for _ in range(600):  # until it has begun to write
        if any(p.suffix == ".tmp" for p in tmp_path.iterdir()):
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert path.read_bytes() == SMALL + moves
    assert [p.name for p in tmp_path.iterdir()] == ["long.gcode"]
