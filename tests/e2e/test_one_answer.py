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


def test_a_target_is_refused_before_the_work_and_by_the_same_rule(folder: Path) -> None:
    """Of every verb that writes: no folder, no file that is read, nothing that exists unless --force says so."""
    (folder / "there.toml").write_text("mine", encoding="utf-8")
    ringing = ("identify", "ringing", "--x-hz", "48", "-m", "ender-3")
    refused = [
        (*ringing, "-o", "there.toml"),
        (*ringing, "-o", "none/new.toml"),
        (*ringing, "-o", "."),
        ("record", "plan", "-m", "mp-delta-pro", "--print", "print.gcode", "-o", "print.gcode"),
        ("record", "plan", "-m", "mp-delta-pro", "-o", "none/moves.gcode"),
        ("estimate", "print.gcode", "-m", "mp-delta-pro", "--figure", "none/time.png"),
        ("frf", "-m", "mp-delta-pro", "--figure", "none/bode.png"),
        ("simulate", "print.gcode", "-m", "mp-delta-pro", "-o", "print.gcode"),
        ("compare", "print.gcode", "-m", "mp-delta-pro", "--report", "none/page.html"),
        ("diagnose", "print.gcode", "-m", "mp-delta-pro", "-o", "there.toml"),
    ]
    for words in refused:
        result = ffcomp(*words, cwd=folder)
        assert (result.exit_code, result.stdout) == (2, ""), (words, result.output)
        assert words[-1] in result.stderr and words[-2].removeprefix("-o") in result.stderr
    assert (folder / "there.toml").read_text(encoding="utf-8") == "mine"
    assert ffcomp(*ringing, "-o", "there.toml", "--force", cwd=folder).exit_code == 0


@pytest.mark.parametrize(
    "words",
    [
        "compensate none.gcode -m mp-delta-pro -o out.gcode",
        "show none.gcode",
        "estimate none.gcode -m mp-delta-pro",
        "restore none.gcode",
        "compare none.gcode -m mp-delta-pro",
        "simulate none.gcode -m mp-delta-pro",
        "frf -m none.toml",
        "frf -m mp-delta-pro --measured none.csv",
        "gap none.csv -m mp-delta-pro",
        "diagnose none.csv -m mp-delta-pro",
        "identify fit none.csv -m mp-delta-pro",
        "identify scan none.png --plan none.json -m ender-3",
        "identify decouple none.csv -m mp-delta-pro",
        "identify update none.csv -m mp-delta-pro -o new.toml",
        "record plan -m none.toml -o moves.gcode",
        "record join none.csv --plan none.json -m mp-delta-pro -o runs",
        "record print none.gcode none.csv -m mp-delta-pro -o runs",
        "record check none.csv --plan none.json -m mp-delta-pro",
        "machines show none.toml",
        "machines check none.toml",
        "machines diff none.toml kossel",
        "machines import none.cfg",
    ],
)
def test_a_missing_file_is_exit_code_2(words: str, tmp_path: Path) -> None:
    result = ffcomp(*words.split(), cwd=tmp_path)
    assert result.exit_code == 2 and "none" in result.stderr, result.output
    assert [*tmp_path.iterdir()] == []
