"""What a job found, as the page shows it: the answer that its verb prints, without commands to type."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ffcomp.request import Declared
from ffcomp.result import Answer

VERBS = (  # "ffcomp leaves 2 µm" is no command
    "check|compare|compensate|diagnose|estimate|frf|gap|identify|log|machines|record|restore|serve|show|simulate|warmup"
)
COMMAND = re.compile(rf"\bffcomp (?:{VERBS})\b|(?<![\w-])--[a-z]")  # text that only the command line understands
OPTION = re.compile(r"(?<![\w-])--(no-)?([a-z][a-z-]*)( (?:on|off|auto|[-\d.,]*\d)\b)?")
MEASURES = re.compile(r"^Measure first: ")
MEASURE = "Measure the machine: see Know my machine."
FIGURE = re.compile(r'src="data:image/svg\+xml;base64,([A-Za-z0-9+/=]+)"')


def answer_of(result: Mapping[str, Any], form: Mapping[str, Declared] = MappingProxyType({})) -> Answer:
    """Return what the page shows of a verb's JSON object; form : the options that the page offers for the verb."""
    if not (told := result.get("answer")):
        return Answer()
    labels = {each.names[0]: each for each in form.values()}

    def shown(text: str) -> str:
        """Name options as the page does, and leave out sentences with a command or another option."""
        text = OPTION.sub(lambda stated: _labelled(stated, labels.get(f"--{stated[2]}")), text)
        return " ".join(each for each in re.split(r"(?<=[.!?]) (?=[A-Z])", text) if not COMMAND.search(each))

    steps = [MEASURE if MEASURES.search(each) else shown(each) for each in told["next_steps"]]
    facts = [(name, shown(value) or value) for name, value in told["facts"]]
    warnings = [shown(each) or each for each in told["warnings"]]
    return Answer(told["headline"], facts, warnings, list(filter(None, steps)))


def _labelled(stated: re.Match[str], option: Declared | None) -> str:
    if option is None:
        return stated[0]
    value = (" no" if stated[1] else " yes") if option.is_switch else stated[3] or ""
    return f"“{option.option.label}{':' * bool(value)}{value}”"


def keep_first_figure(report: Path, picture: Path, panel: Path) -> None:
    """Write the first figure of a report as the picture below the answer, or as its panel for phones."""
    with suppress(OSError):
        if figure := FIGURE.search(report.read_text(encoding="utf-8")):
            (panel if picture.exists() else picture).write_bytes(base64.b64decode(figure[1]))
