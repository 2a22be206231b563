"""Every verb shows people the same words wherever they look: the terminal prints the answer of `--json`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ffcomp.result import Answer
from tests.support.cli import ffcomp
from tests.support.configs import Delta, written

SQUARE = b"G28\nG90\nM83\nG1 X10 Y0 Z20 F6000\nG1 X20 Y0 E.3\nG1 X20 Y10 E.3\nG1 X10 Y10 E.3\nG1 X10 Y0 E.3\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "print.gcode").write_bytes(SQUARE)
    written(tmp_path, Delta().klipper(), "printer.cfg")
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        "machines list",
        "machines show ender-3",
        "machines check mp-delta-pro-as-printed",
        "machines diff mp-delta-pro kossel",
        "machines import printer.cfg -o imported.toml",
        "frf -m mp-delta-pro --at 0,0 --at -80,0",
        "estimate print.gcode -m mp-delta-pro --layers",
        "estimate print.gcode print.gcode -m mp-delta-pro",
        "record plan -m mp-delta-pro -o moves.gcode --seconds 2 --at 0,0",
        "record plan --for scan -m ender-3 -o page.gcode",
        "identify ringing --x-hz 48 --y-hz 37 -m ender-3 -o better.toml",
    ],
)
def test_the_terminal_prints_the_answer_of_the_object(words: str, folder: Path) -> None:
    printed = ffcomp(*words.split(), "-q", cwd=folder)
    for made in ("imported.toml", "better.toml"):
        (folder / made).unlink(missing_ok=True)
    objects = [json.loads(line) for line in ffcomp(*words.split(), "--json", cwd=folder).stdout.splitlines()]
    assert printed.exit_code == 0, printed.output
    assert {each["schema"].partition("/")[2] for each in objects} == {"1"}
    assert list(Answer(**objects[0]["answer"]).lines()) == printed.stdout.splitlines()
    assert objects[0]["answer"]["headline"] and len(printed.stdout.splitlines()) > 1
