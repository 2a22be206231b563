"""The log: what every run was asked, what it said, how it ended. Slicers drop what a script prints, or show it once.

It is `ffcomp.log` in the platform's folder for logs (`ffcomp --log-path` says which). The environment variable
FFCOMP_LOG names another file, and `off` stands for none. A log that cannot be written never stops a run.
"""

from __future__ import annotations

import logging
import os
import platform
import shlex
import sys
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from logging.handlers import RotatingFileHandler
from pathlib import Path

from ffcomp.version import __version__

LARGEST = 1 << 20  # bytes; then the file becomes ffcomp.log.1, and the one before that is gone

LOGGER = logging.getLogger("ffcomp")
LOGGER.setLevel(logging.INFO)
LOGGER.propagate = False
LOGGER.addHandler(logging.NullHandler())  # where nothing is logged, nothing is printed either


def log_path(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Where runs are logged; None where they are not."""
    named = environment.get("FFCOMP_LOG", "")
    if named.lower() == "off":
        return None
    if named:
        return Path(named)
    import platformdirs

    return Path(platformdirs.user_log_dir("ffcomp")) / "ffcomp.log"


def note(text: str) -> None:
    """Write a message into the log of this run, every line with its time and process."""
    for line in text.encode("utf-8", "backslashreplace").decode().splitlines():  # names of files may be no text
        LOGGER.info("%s", line)


@contextmanager
def logged(arguments: list[str]) -> Iterator[None]:
    """Log one run of the command line: its beginning, the messages given to `note`, its end."""
    log, started, code = _opened(), time.perf_counter(), "1"
    if log is not None:
        LOGGER.addHandler(log)
    note(f"ffcomp {__version__}, Python {platform.python_version()}, {platform.system()}, in {_folder()}")
    note(shlex.join(["ffcomp", *arguments]))
    if "SLIC3R_PP_HOST" in os.environ:
        note(f"called by a slicer, for {os.environ['SLIC3R_PP_HOST']}: {os.environ.get('SLIC3R_PP_OUTPUT_NAME')}")
    try:
        yield
        code = "0"
    except SystemExit as end:
        code = str(end.code or 0)
        raise
    except BaseException:
        note(traceback.format_exc())
        if log is not None:
            print(f"ffcomp: This is a fault of ffcomp's own; what led to it is in {log.baseFilename}.", file=sys.stderr)
        raise
    finally:
        note(f"exit code {code} after {time.perf_counter() - started:.1f} s")
        if log is not None:
            LOGGER.removeHandler(log)
            with suppress(OSError):
                log.close()


def _folder() -> str:
    """Return the current folder, which may have been deleted."""
    try:
        return os.getcwd()
    except OSError as error:
        return f"an unknown folder ({error.strerror})"


class _Log(RotatingFileHandler):
    def handleError(self, record: logging.LogRecord) -> None:
        """Do without a line that cannot be written."""


def _opened() -> _Log | None:
    """Open the log; None if it cannot be written."""
    with suppress(OSError, RuntimeError):  # RuntimeError: no home folder
        if path := log_path():
            path.parent.mkdir(parents=True, exist_ok=True)
            log = _Log(path, maxBytes=LARGEST, backupCount=1, encoding="utf-8")
            log.setFormatter(logging.Formatter("%(asctime)s [%(process)d] %(message)s", "%Y-%m-%dT%H:%M:%S%z"))
            return log
    return None
