"""Help pages: 80 columns, no name cut, every option in a group, switches without a value, `-h` everywhere."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from ffcomp.cli.app import app
from ffcomp.cli.help import GROUPS

COLUMNS = 80


def verbs(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """All verbs and groups of verbs, each with what is typed for it."""
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from verbs(inner, (*path, name))


VERBS = dict(verbs(typer.main.get_command(app)))


def help_of(path: tuple[str, ...], flag: str = "--help") -> str:
    """The help page as a user with a terminal of 80 columns sees it."""
    code = "from ffcomp.cli.app import main; main()"
    answer = subprocess.run(
        [sys.executable, "-c", code, *path, flag],
        capture_output=True,
        text=True,
        check=True,
        env={"COLUMNS": str(COLUMNS), "FFCOMP_LOG": "off", "PYTHONPATH": ":".join(sys.path), "PYTHONUTF8": "1"},
    )
    return answer.stdout


@pytest.mark.parametrize("path", VERBS, ids=lambda path: " ".join(path) or "ffcomp")
def test_names_stand_whole_in_80_columns(path: tuple[str, ...]) -> None:
    page = help_of(path)
    assert max(map(len, page.split("\n"))) <= COLUMNS
    for parameter in VERBS[path].params:
        for name in (*parameter.opts, *parameter.secondary_opts):
            wanted = parameter.metavar if parameter.param_type_name == "argument" else name
            assert re.search(rf"(?<![\w-]){re.escape(wanted)}(?![\w-])", page), wanted


@pytest.mark.parametrize("path", [path for path in VERBS if path], ids=" ".join)
def test_options_stand_in_groups_and_name_what_they_take(path: tuple[str, ...]) -> None:
    for parameter in VERBS[path].params:
        if parameter.param_type_name == "argument":
            continue
        assert parameter.rich_help_panel in GROUPS, parameter.name
        assert bool(parameter.metavar) != parameter.is_flag, f"{parameter.name}: a switch takes no value, others say it"
        assert parameter.help


def test_the_short_flag_says_the_same() -> None:
    for path in ((), ("compensate",), ("machines",), ("machines", "show")):
        assert help_of(path, "-h") == help_of(path)


def test_first_lines_are_imperative_and_plain() -> None:
    first = {" ".join(path): (command.help or "").split("\n\n")[0] for path, command in VERBS.items()}
    assert first["compensate"] == "Compensate a print for your printer's vibration."
    for verb, line in first.items():
        assert re.fullmatch(r"[A-Z][a-z]+[ ,].*\.", " ".join(line.split())), verb


def test_a_usage_error_shows_the_usage_of_the_help_page() -> None:
    from typer.testing import CliRunner

    first = help_of(("compensate",)).split("\n")[0].split("compensate")[1]
    assert first in CliRunner().invoke(app, ["compensate"]).output
