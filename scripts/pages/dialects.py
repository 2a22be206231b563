"""docs/DIALECTS.md: what becomes of each line is what the reader makes of it, and macros that come back are its own.

Which lines the page shows, for which firmware, and what it says of each, is written by hand, in the other columns.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from gcode.commands import RETURNING_MACROS, STILL_MACROS
from gcode.errors import GcodeError
from gcode.program import EventKind, Program
from gcode.reader import read_program

PAGE = Path(__file__).parents[2] / "docs" / "DIALECTS.md"
START = "G28\nG90\nM83\nG1 X10 Y10 Z5 F6000\nSAVE_GCODE_STATE NAME=a\nG1 X11 Y10 E.1\n"
OUTCOMES = {
    "compensated": "replaced by segments",
    "followed": "goes out as it is, at its move's time, and what comes after is read by it",
    "passes": "goes out as it is, at its move's time; the motion goes on",
    "waits": "the motion rests for that long, and the line goes out",
    "rests": "the motion rests before it; the line goes out as it is",
    "rests, place unknown": "and moves go out as they are until the file has named X and Y again",
    "refused": "the file is not changed; exit code 4, with the line and the rule",
}
_ROW = re.compile(r"^\| `(.+?)` \| (\w*) \| ([\w, ]*?) \|", re.MULTILINE)
_TABLE = r"(?<=^\| {} \|\n\|---\|---\|\n)(?:\|.*\n)*"


class Row(NamedTuple):
    """A line of the page's tables."""

    code: str  # lines of G-code
    flavor: str
    outcome: str


def rows(text: str) -> list[Row]:
    """Return each row that holds a snippet."""
    return [Row(_code(code), flavor or "marlin", outcome) for code, flavor, outcome in _ROW.findall(text)]


def page() -> str:
    """Return the text of docs/DIALECTS.md, its tables filled in anew."""

    def row(match: re.Match[str]) -> str:
        return f"| `{match[1]}` | {match[2]} | {outcome(_code(match[1]), match[2] or 'marlin')} |"

    text = _ROW.sub(row, PAGE.read_text(encoding="utf-8"))
    macros = {
        what: " ".join(f"`{name}`" for name in names) for what, names in (RETURNING_MACROS | STILL_MACROS).items()
    }
    for head, table in (("word | what becomes of the line", OUTCOMES), ("what | names", macros)):
        lines = "".join(f"| {key} | {value} |\n" for key, value in table.items())
        text = re.sub(_TABLE.format(re.escape(head)), lambda _, lines=lines: lines, text, flags=re.MULTILINE)  # type: ignore[misc]
    return text


def _code(shown: str) -> str:
    return shown.replace(" ⏎ ", "\n").replace("\\|", "|")


def outcome(snippet: str, flavor: str) -> str:
    """What becomes of the snippet's last line in a print."""
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
    """Whether the modes, names of places, factors or the feed are others after a line than before it."""
    moves = program.moves
    frames = {event.line: event.frame for event in program.events}
    frames |= dict(zip(moves.line.tolist(), moves.frame.tolist(), strict=True))
    return frames[line] != frames[line - 1]
