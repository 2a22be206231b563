"""What a job found, as the page shows it: the answer that its verb prints, without commands to type."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ffcomp.result import Answer

VERBS = (  # "ffcomp leaves 2 µm" is no command
    "check|compare|compensate|diagnose|estimate|frf|gap|identify|log|machines|record|restore|serve|show|simulate|warmup"
)
COMMAND = re.compile(rf"\bffcomp (?:{VERBS})\b|(?<![\w-])--[a-z]")  # text that only the command line understands
MEASURES = re.compile(r"^Measure first: ")
MEASURE = "Measure the machine: see Know my machine."
FIGURE = re.compile(r'src="data:image/svg\+xml;base64,([A-Za-z0-9+/=]+)"')


def answer_of(result: Mapping[str, Any]) -> Answer:
    """Return what the page shows of a verb's JSON object."""
    if not (told := result.get("answer")):
        return Answer()
    steps = [MEASURE if MEASURES.search(each) else _without_commands(each) for each in told["next_steps"]]
    facts = [(name, _without_commands(value) or value) for name, value in told["facts"]]
    warnings = [_without_commands(each) or each for each in told["warnings"]]
    return Answer(told["headline"], facts, warnings, list(filter(None, steps)))


def _without_commands(text: str) -> str:
    """Return the sentences without a command or an option of the command line; empty: none is left."""
    return " ".join(each for each in re.split(r"(?<=[.!?]) (?=[A-Z])", text) if not COMMAND.search(each))


def keep_first_figure(report: Path, picture: Path) -> None:
    """Write the first figure of a report, which the page shows below the answer, unless a verb has drawn its own."""
    with suppress(OSError):
        if not picture.exists() and (figure := FIGURE.search(report.read_text(encoding="utf-8"))):
            picture.write_bytes(base64.b64decode(figure[1]))
