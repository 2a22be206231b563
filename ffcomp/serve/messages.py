"""A job as the page shows it: its progress, the reason for its failure, and the answer without commands to type."""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ffcomp.request import Declared
from ffcomp.result import Answer, time_left

TAIL = 1 << 16  # bytes of the log that are read
OURS = "ffcomp: "
_KILLED = (
    "The process was killed (signal {signal}), often because memory ran out. "
    "None of your files was changed: start it again."
)
_FAULT = "Internal error. See the log below."


def tail(log: Path) -> str:
    """Return the end of a log; empty where there is none yet."""
    try:
        with open(log, "rb") as file:
            file.seek(max(0, file.seek(0, 2) - TAIL))
            return file.read().decode("utf-8", "replace")
    except OSError:
        return ""


def log_end(place: Path) -> str:
    """Return the end of a job's log, with the user's file names."""
    return without_folder(tail(place / "log.txt"), place)


def without_folder(text: str, place: Path) -> str:
    """Remove the server's folders from a text."""
    for folder in (place / "in", place / "out", place):
        text = text.replace(f"{folder}{os.sep}", "")
    return text


def progress(events: Path, doing: str) -> tuple[float | None, str]:
    """Return the share that is done, 0 to 1 or None, and the stage with the time left.

    events : the file of a step's events
    doing : the step's name, used before its first event
    """
    with suppress(IndexError, ValueError, KeyError):
        event = json.loads(tail(events).rstrip("\n").rsplit("\n", 1)[-1])
        left_s = event["left_s"]
        return event["share"], event["stage"] + ("" if left_s is None else f", {time_left(left_s)}")
    return None, doing


def why_failed(code: int, text: str) -> str:
    """Return the reason for an exit code in a sentence."""
    if code < 0 or code in (137, 9):
        return _KILLED.format(signal=abs(code) if code < 0 else 9)
    lines = [line.removeprefix(OURS) for line in text.splitlines() if line.startswith(OURS)]
    if code == 1 and "Traceback" in text:
        return _FAULT
    return (lines or [f"It ended with exit code {code}."])[-1]


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
