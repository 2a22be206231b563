"""What the tests of docs/reference share: tables and examples out of pages, verbs called as a user calls them."""

from __future__ import annotations

import re
from pathlib import Path

from ffcomp.cli.app import app
from tests.support.cli import CliRunner, Result

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs" / "reference"
MACHINE_FILE = REFERENCE / "machine_file.md"
SMALL = b"G28\nG90\nM83\nG1 Z0.3 F6000\nG1 X10 Y10 F9000\n;LAYER:0\nG1 X30 Y12 E1\nG1 X28 Y30 E1\nG4 P20\nM107\n"
MACHINE = ("-m", "mp-delta-pro")


def rows_of(page: Path, section: str) -> list[list[str]]:
    """The cells of the first table under a heading, without its own two lines."""
    text = page.read_text(encoding="utf-8")
    body = re.split(rf"^##+ {re.escape(section)}\n", text, maxsplit=1, flags=re.MULTILINE)[1]
    table = body.partition("\n| ")[2].partition("\n\n")[0]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in table.splitlines()[2:]]


def examples(page: Path, language: str) -> list[str]:
    """The fenced blocks of one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def call(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(app, [*map(str, arguments)])
    assert result.exit_code == code, result.output
    return result
