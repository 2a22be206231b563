"""What an interrupt says is so, wherever it comes: before, within or after the moment a file takes its place."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from ffcomp.cli.app import app
from gcode.atomic_write import drafts_noted, replaced_since, replacing
from tests.support.cli import CliRunner
from tests.support.prints import squares

MACHINE = "mp-delta-pro"


@pytest.fixture
def printed(tmp_path: Path) -> Path:
    path = tmp_path / "squares.gcode"
    path.write_bytes(squares(1))
    return path


def interrupted(
    monkeypatch: pytest.MonkeyPatch, owner: object, name: str, *, after: bool, wrapped: bool = False
) -> None:
    """Let Ctrl-C come just before or just after a function has done its work, or wrapped as compiled code does."""
    function: Any = getattr(owner, name)

    def with_interrupt(*args: Any, **options: Any) -> Any:
        mine = name != "replace" or str(args[1]).endswith(".gcode")  # the cache of tables is none of the user's files
        if after or not mine:
            function(*args, **options)
        if mine and wrapped:
            raise SystemError("a result with an exception set") from KeyboardInterrupt()
        if mine:
            raise KeyboardInterrupt

    monkeypatch.setattr(owner, name, with_interrupt)


@pytest.mark.parametrize("wrapped", [False, True], ids=["in Python", "in compiled code"])
def test_before_the_file_takes_its_place(printed: Path, monkeypatch: pytest.MonkeyPatch, wrapped: bool) -> None:
    before = printed.read_bytes()
    interrupted(monkeypatch, os, "replace", after=False, wrapped=wrapped)
    call = CliRunner().invoke(app, ["compensate", str(printed), "-m", MACHINE, "--no-predict"])
    assert call.exit_code == 130 and "Interrupted; no file was changed." in call.output
    assert printed.read_bytes() == before and [path.name for path in printed.parent.iterdir()] == [printed.name]


@pytest.mark.parametrize("moment", ["the rename", "the report"])
def test_after_the_file_has_taken_its_place(printed: Path, monkeypatch: pytest.MonkeyPatch, moment: str) -> None:
    """The line of 100 % comes before; whoever interrupts then has a compensated file, and is told."""
    before = printed.read_bytes()
    if moment == "the rename":
        interrupted(monkeypatch, os, "replace", after=True)
    else:
        from ffcomp.cli import command

        interrupted(monkeypatch, command, "answer", after=False)
    call = CliRunner().invoke(app, ["compensate", str(printed), "-m", MACHINE, "--no-predict"])
    assert call.exit_code == 130 and "no file was changed" not in call.output
    assert f"Interrupted; {printed} had been written before, and is complete." in call.output
    assert printed.read_bytes() != before and b"Processed by ffcomp" in printed.read_bytes()
    monkeypatch.undo()
    assert CliRunner().invoke(app, ["restore", str(printed)]).exit_code == 0 and printed.read_bytes() == before


def test_what_is_in_place_is_known_from_the_file_itself(tmp_path: Path) -> None:
    target, noted = tmp_path / "a", drafts_noted()
    with replacing(target) as file:
        file.write(b"1")
        assert replaced_since(noted) == []
    assert replaced_since(noted) == [str(target)]
    target.unlink()
    target.write_bytes(b"another's")
    os.utime(target)
    assert replaced_since(drafts_noted()) == []
