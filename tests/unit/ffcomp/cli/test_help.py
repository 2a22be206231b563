"""Help pages: 80 columns, no name cut, every option in a group, switches without a value, `-h` everywhere."""

from __future__ import annotations

import re
from io import StringIO

import pytest
from rich.console import Console

from ffcomp.cli.app import app, command_line
from ffcomp.cli.command import commands
from tests.support.cli import CliRunner

COLUMNS = 80
VERBS = {path: (command, options) for path, command, options in commands(app)}


def help_of(path: tuple[str, ...]) -> str:
    """The help page as a user with a terminal of 80 columns sees it."""
    page = StringIO()
    (app if path else command_line(overview=True)).help_print(list(path), console=Console(file=page, width=COLUMNS))
    return page.getvalue()


@pytest.mark.parametrize("path", VERBS, ids=lambda path: " ".join(path) or "ffcomp")
def test_names_stand_whole_in_80_columns(path: tuple[str, ...]) -> None:
    page = help_of(path)
    assert max(map(len, page.split("\n"))) <= COLUMNS
    for each in VERBS[path][1]:
        for name in (each.option.metavar.rstrip("."),) if each.option.positional else (*each.names, each.negative):
            assert re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", page), name


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("compensate", "FILE is missing"),
        ("compensate a.gcode", "--machine is missing"),
        ("compensate a.gcode -m kossel --fo", "--fo. Did you mean --force?"),
        ("compensate a.gcode -m kossel --jobs two", '"two"'),
        ("compensate a.gcode -m kossel --tolerance-um 0", "--tolerance-um 0: it must be at least 0.1"),
        ("nothing", '"nothing"'),
        ("compensate a.gcode -m kossel --max-speed-mm-per-s 90", "-per-s needs the error that a quicker print may"),
        ("compensate a.gcode -m kossel --safety 0.1", "--safety needs the error that a quicker print may have"),
        ("compensate a.gcode -m kossel --max-error-um 9 --max-error-um 8", "--max-error-um 8: it is given twice."),
        ("compensate a.gcode -m kossel --kind host -o o.gcode", "--kind host writes a file that ends in .ffm."),
        ("compensate a.gcode -m kossel --max-error-um 0.01", "it is a number of µm from 0.1 to 10000"),
        ("compensate a.gcode -m kossel --max-error-um infill=9", "One --max-error-um without a feature says"),
        ("frf -m kossel --lowest-hz 300", "--lowest-hz 300 lies above --highest-hz 200."),
        ("frf -m kossel --step-hz 0.01 --highest-hz 9000", "take a larger step."),
        ("record plan -m kossel -o a.json", "-o a.json: the G-code needs another ending"),
        ("record plan -m kossel -o a.gcode --bed-c 60", "--bed-c is for --for scan, not for --for diagnose."),
        ("record plan -m voron-300 -o a.gcode --for identify --at line-of-action", "that is a delta's"),
    ],
)
def test_a_usage_error_is_a_sentence_with_exit_code_2(words: str, sentence: str) -> None:
    answer = CliRunner().invoke(app, words.split(), env={"FFCOMP_MACHINE": None})
    assert answer.exit_code == 2 and sentence in answer.stderr and not answer.stdout
    assert answer.stderr.startswith("ffcomp: ") and answer.stderr.count("\n") == 1


def test_without_a_verb_the_help_is_shown_and_nothing_is_done() -> None:
    for words in ([], ["record"]):
        answer = CliRunner().invoke(app, words)
        assert answer.exit_code == 2 and "Usage: ffcomp" in answer.stderr
