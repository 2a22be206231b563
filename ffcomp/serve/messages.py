"""What a process says on stderr, read as progress while it runs and as the reason when it fails."""

from __future__ import annotations

import os
import re
from pathlib import Path

TAIL = 1 << 16  # bytes of the log that are read
OURS = "ffcomp: "
_SHARE = re.compile(r"^ffcomp: (\d+) %, (\d+) s left$")
_STEP = re.compile(r"^\[(\d+)/(\d+)\] ")
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


def progress(text: str, doing: str) -> tuple[float | None, str]:
    """Return the share that is done, 0 to 1, if the last line that tells says so, and what is being done.

    text : the end of a log
    doing : what the step is called, where the log says nothing better
    """
    for line in reversed(text.splitlines()):
        if match := _SHARE.match(line):
            return int(match[1]) / 100, f"{doing}, {match[2]} s left"
        if match := _STEP.match(line):
            return int(match[1]) / int(match[2]), doing
        if line.startswith(OURS):
            return None, line.removeprefix(OURS)
    return None, doing


def why_failed(code: int, text: str) -> str:
    """Return the reason for an exit code in a sentence."""
    if code < 0 or code in (137, 9):
        return _KILLED.format(signal=abs(code) if code < 0 else 9)
    lines = [line.removeprefix(OURS) for line in text.splitlines() if line.startswith(OURS)]
    lines = [line for line in lines if not _SHARE.match(OURS + line) and not line.endswith("…")]
    if code == 1 and "Traceback" in text:
        return _FAULT
    usage = [line.removeprefix("Error: ") for line in text.splitlines() if line.startswith("Error: ")]
    return (lines or usage or [f"It ended with exit code {code}."])[-1]
