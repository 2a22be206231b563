"""docs/DIALECTS.md: fill in the outcome of each line and the lists of macros, as the reader treats them.

The snippets, firmwares and notes of its tables are written by hand.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from gcode.commands import RETURNING_MACROS
from gcode.errors import GcodeError
from gcode.program import EventKind, Program
from gcode.reader import read_program

PAGE = Path(__file__).parents[2] / "docs" / "DIALECTS.md"
START = "G28\nG90\nM83\nG1 X10 Y10 Z5 F6000\nSAVE_GCODE_STATE NAME=a\nG1 X11 Y10 E.1\n"
OUTCOMES = {
    "compensated": "replaced by segments",
    "followed": "unchanged, at the time of its move; later lines are read accordingly",
    "passes": "unchanged, at the time of its move; the motion continues",
    "waits": "unchanged; the motion stops for that time",
    "rests": "unchanged; the motion stops before it",
    "rests, place unknown": "likewise, and moves stay uncompensated until the file sets X and Y again",
    "refused": "no file is written; exit code 4, with the line and the rule",
}
_ROW = re.compile(r"^\| `(.+?)` \| (\w*) \| ([\w, ]*?) \|", re.MULTILINE)
_TABLE = r"(?<=^\| {} \|\n\|---\|---\|\n)(?:\|.*\n)*"


class Row(NamedTuple):
    """A line of the page's tables."""

    code: str  # lines of G-code
    flavor: str
    outcome: str


def rows(text: str) -> list[Row]:
    """Return each row with a snippet."""
    return [Row(_code(code), flavor or "marlin", outcome) for code, flavor, outcome in _ROW.findall(text)]


def page() -> str:
    """Return the text of docs/DIALECTS.md with its tables filled in."""

    def row(match: re.Match[str]) -> str:
        return f"| `{match[1]}` | {match[2]} | {outcome(_code(match[1]), match[2] or 'marlin')} |"

    text = _ROW.sub(row, PAGE.read_text(encoding="utf-8"))
    macros = {what: " ".join(f"`{name}`" for name in names) for what, names in RETURNING_MACROS.items()}
    for head, table in (("outcome | the line in the output", OUTCOMES), ("kind | names", macros)):
        lines = "".join(f"| {key} | {value} |\n" for key, value in table.items())
        text = re.sub(_TABLE.format(re.escape(head)), lambda _, lines=lines: lines, text, flags=re.MULTILINE)  # type: ignore[misc]
    return text


def _code(shown: str) -> str:
    return shown.replace(" ⏎ ", "\n").replace("\\|", "|")


def outcome(snippet: str, flavor: str) -> str:
    """Return the outcome of the snippet's last line in a print."""
    data = (START + snippet + "\nG1 X12 Y11 Z6 E.1\n").encode()
    try:
        program = read_program(data, flavor=flavor)
    except GcodeError:
        return "refused"
    line = (START + snippet).count("\n")
    if line in program.moves.line:
        return "compensated"
    event = next(event for event in program.events if event.line == line)
    if event.kind is EventKind.STOP:
        return "rests" if line + 1 in program.moves.line else "rests, place unknown"
    if event.kind is EventKind.DWELL:
        return "waits"
    return "followed" if event.limits or _changes(program, line) else "passes"


def _changes(program: Program, line: int) -> bool:
    """Whether a line changes modes, coordinate offsets, factors or the feed rate."""
    moves = program.moves
    frames = {event.line: event.frame for event in program.events}
    frames |= dict(zip(moves.line.tolist(), moves.frame.tolist(), strict=True))
    return frames[line] != frames[line - 1]
