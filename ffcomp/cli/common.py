"""Messages, exit codes and progress of all verbs.

Errors become sentences on stderr and exit codes. Messages go to stderr and to the log (`ffcomp.cli.log`), progress to
stderr only.
"""

from __future__ import annotations

import gc
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.util import find_spec
from shutil import get_terminal_size
from textwrap import fill
from typing import TYPE_CHECKING

from ffcomp.cli.log import note
from ffcomp.errors import INPUT_ERRORS, explain, interrupts_restored, missing_extras_explained, not_installed
from ffcomp.numerics.serialise import json_line
from gcode.atomic_write import drafts_noted, replaced_since
from models.errors import MachineFileError

if TYPE_CHECKING:
    from ffcomp.result import Result


NEW_OBJECTS = 50_000  # after which garbage is collected


def collect_rarely() -> None:
    """Collect garbage less often until the process ends: modules and compiled code stay in use anyway."""
    gc.set_threshold(NEW_OBJECTS, 50, 100)


@contextmanager
def exit_codes() -> Iterator[None]:
    """Turn errors of the input into one sentence and the documented exit code. A bug keeps its traceback (1)."""
    noted = drafts_noted()
    try:
        with interrupts_restored(), missing_extras_explained():
            yield
    except KeyboardInterrupt:
        names = replaced_since(noted)
        written = f"{', '.join(names)} had been written before, and {'is' if len(names) == 1 else 'are'} complete"
        fail(f"Interrupted; {written if names else 'no file was changed'}.", 130)
    except BrokenPipeError:  # who reads our output has seen enough (`| head`): end as other tools do
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(141) from None
    except INPUT_ERRORS as error:
        fail(*explain(error))


@contextmanager
def machine_errors(as_json: bool) -> Iterator[None]:
    """Print the mistakes of a machine file also as a JSON object, with --json."""
    try:
        yield
    except MachineFileError as error:
        if as_json:
            print(json_line({"schema": "ffcomp-machine-error/1", "path": error.path, "problems": error.problems}))
        raise


def require(package: str) -> None:
    """Say at once that a package of an extra is missing, not after minutes of work."""
    if find_spec(package) is None:
        fail(*explain(not_installed(package)))


def fail(sentence: str, code: int) -> None:
    """Print a sentence on stderr and exit with this code."""
    say(f"ffcomp: {sentence}")
    raise SystemExit(code)


def say(sentence: str) -> None:
    """Print a message on stderr, and keep it in the log; stdout is for results."""
    note(sentence)
    print(sentence, file=sys.stderr)


_hidden: ContextVar[bool] = ContextVar("_hidden", default=False)


@contextmanager
def quiet(hidden: bool) -> Iterator[None]:
    """Within it `report` prints nothing, if so."""
    token = _hidden.set(hidden)
    try:
        yield
    finally:
        _hidden.reset(token)


def is_quiet() -> bool:
    """Return whether progress is hidden (--quiet)."""
    return _hidden.get()


def report(sentence: str) -> None:
    """Report progress: in the log, and on stderr unless it is quiet."""
    (note if is_quiet() else say)(f"ffcomp: {sentence}")


def answer(result: Result, as_json: bool) -> None:
    """Print a result on stdout, as JSON or as text; the log has the text in any case. Then raise what it failed by."""
    lines = list(result.answer.lines())
    for each in lines:
        note(each)
    if as_json:
        print(*map(json_line, result.objects()), sep="\n", flush=True)
    else:
        width = get_terminal_size().columns if sys.stdout.isatty() else 0
        print(*(_wrapped(each, width) for each in lines), sep="\n", flush=True)
    if result.failure is not None:
        raise result.failure


def _wrapped(line: str, width: int) -> str:
    """Wrap a line, the rest indented below its value; a fact's value begins after two spaces."""
    if not 40 <= width < len(line):
        return line
    name = re.match(r"  \S.*?  +", line)
    indent = len(name[0]) if name else 2
    return fill(line, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False)
