"""Call the command line within this process, as a user calls it."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from pathlib import Path

from cyclopts import App

from ffcomp.cli.app import app as whole
from ffcomp.cli.command import run

PLAIN = {"NO_COLOR": "1", "COLUMNS": "200"}


@dataclass(frozen=True)
class Result:
    """How a run of the command line ended, and what it printed."""

    exit_code: int
    stdout: str
    stderr: str
    output: str  # both, as a terminal shows them
    exception: BaseException | None


class CliRunner:
    def invoke(self, app: App, words: Sequence[str] = (), env: Mapping[str, str | None] | None = None) -> Result:
        """Run a command; what it raises becomes the result's `exception`."""
        both = io.StringIO()
        streams = _Copied(both), _Copied(both)
        code = 0
        exception: BaseException | None = None
        with _environment(env or {}), _printed_to(*streams):
            try:
                run(app, [*words])
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else int(end.code is not None)
                exception = end if code else None
            except Exception as error:
                code, exception = 1, error
        out, err = (stream.getvalue() for stream in streams)
        return Result(code, out, err, both.getvalue(), exception)


def ffcomp(*words: object, cwd: Path | None = None) -> Result:
    """Run `ffcomp WORDS` without colour in a wide terminal; bugs are raised, warnings are none of a user's errors."""
    with chdir(cwd or Path.cwd()), warnings.catch_warnings():
        warnings.simplefilter("default")
        result = CliRunner().invoke(whole, [*map(str, words)], env=PLAIN)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


class _Copied(io.StringIO):
    encoding = "utf-8"

    def __init__(self, other: io.StringIO) -> None:
        super().__init__()
        self.other = other

    def write(self, text: str) -> int:
        self.other.write(text)
        return super().write(text)


@contextmanager
def _printed_to(out: io.StringIO, err: io.StringIO) -> Iterator[None]:
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = out, err
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


@contextmanager
def _environment(changes: Mapping[str, str | None]) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update({name: value for name, value in changes.items() if value is not None})
    for name in (name for name, value in changes.items() if value is None):
        os.environ.pop(name, None)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
