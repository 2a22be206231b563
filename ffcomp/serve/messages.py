"""What a process says: its events while it runs, and what it printed on stderr when it fails."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

TAIL = 1 << 16  # bytes of the log that are read
OURS = "ffcomp: "
_KILLED = (
    "The process was killed from outside (signal {signal}). Often that means that there was not enough memory. "
    "Nothing of yours was changed: start it again."
)
_FAULT = "This is a fault of ffcomp's own; what led to it is in its log, below."


def tail(log: Path) -> str:
    """Return the end of a log; empty where there is none yet."""
    try:
        with open(log, "rb") as file:
            file.seek(max(0, file.seek(0, 2) - TAIL))
            return file.read().decode("utf-8", "replace")
    except OSError:
        return ""


def log_end(place: Path) -> str:
    """Return the end of what a job's processes have said, files named as the user named them."""
    return without_folder(tail(place / "log.txt"), place)


def without_folder(text: str, place: Path) -> str:
    """Take the server's folders out of a text: nobody else needs to know them."""
    for folder in (place / "in", place / "out", place):
        text = text.replace(f"{folder}{os.sep}", "")
    return text


def progress(events: Path, doing: str) -> tuple[float | None, str]:
    """Return the share that is done, 0 to 1, where it is known, and what is being done, with the time left.

    events : the file of a step's events
    doing : what the step is called, where none was told yet
    """
    with suppress(IndexError, ValueError, KeyError):
        event = json.loads(tail(events).rstrip("\n").rsplit("\n", 1)[-1])
        left = "" if event["left_s"] is None else f", {event['left_s']:.0f} s left"
        return event["share"], f"{event['stage']}{left}"
    return None, doing


def why_failed(code: int, text: str) -> str:
    """Return the reason for an exit code in a sentence."""
    if code < 0 or code in (137, 9):
        return _KILLED.format(signal=abs(code) if code < 0 else 9)
    lines = [line.removeprefix(OURS) for line in text.splitlines() if line.startswith(OURS)]
    if code == 1 and "Traceback" in text:
        return _FAULT
    usage = [line.removeprefix("Error: ") for line in text.splitlines() if line.startswith("Error: ")]
    return (lines or usage or [f"It ended with exit code {code}."])[-1]
