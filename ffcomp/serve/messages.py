"""A process's events while it runs, and the reason for its failure from stderr."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

from ffcomp.result import time_left

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
