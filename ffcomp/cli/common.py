"""Messages, exit codes and progress of all verbs.

Errors become sentences on stderr and exit codes. Messages go to stderr and to the log (`ffcomp.cli.log`), progress to
stderr only.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from typing import TYPE_CHECKING, Any

from ffcomp.cli.log import note
from ffcomp.errors import INPUT_ERRORS, explain, interrupts_restored, missing_extras_explained, not_installed
from ffcomp.numerics.serialise import json_line
from gcode.atomic_write import drafts_noted, replaced_since

if TYPE_CHECKING:
    from ffcomp.result import Result
    from models.machine import Machine


@contextmanager
def exit_codes() -> Iterator[None]:
    """Turn errors of the input into one sentence and the documented exit code. A bug keeps its traceback (1)."""
    noted = drafts_noted()
    try:
        with interrupts_restored(), missing_extras_explained():
            yield
    except KeyboardInterrupt:
        fail(f"Interrupted; {written_already(noted)}.", 130)
    except BrokenPipeError:  # who reads our output has seen enough (`| head`): end as other tools do
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(141) from None
    except INPUT_ERRORS as error:
        fail(*explain(error))


def require(package: str) -> None:
    """Say at once that a package of an extra is missing, not after minutes of work."""
    if find_spec(package) is None:
        fail(*explain(not_installed(package)))


def written_already(noted: int) -> str:
    """Say which files are complete after an interrupt, of those noted since (`gcode.atomic_write.drafts_noted`)."""
    names = replaced_since(noted)
    if not names:
        return "no file was changed"
    return f"{', '.join(names)} had been written before, and {'is' if len(names) == 1 else 'are'} complete"


def fail(sentence: str, code: int) -> None:
    """Print a sentence on stderr and exit with this code."""
    say(f"ffcomp: {sentence}")
    raise SystemExit(code)


def say(sentence: str, quiet: bool = False) -> None:
    """Print a message on stderr, and keep it in the log; stdout is for results."""
    note(sentence)
    if not quiet:
        print(sentence, file=sys.stderr)


def say_assumed(machines: Iterable[Machine], quiet: bool = False) -> None:
    """Say of each machine whose modes are assumed that they are, once."""
    from models.machine import assumed_modes

    for sentence in dict.fromkeys(filter(None, map(assumed_modes, machines))):
        say(f"ffcomp: {sentence}", quiet)


def answer(result: Result, as_json: bool) -> None:
    """Print a result on stdout, as JSON or as text; the log has the text in any case."""
    lines = list(result.answer.lines())
    for each in lines:
        note(each)
    if as_json:
        print_json(result.to_dict())
        return
    width = get_terminal_size().columns if sys.stdout.isatty() else 0
    print(*(_wrapped(each, width) for each in lines), sep="\n", flush=True)


def _wrapped(line: str, width: int) -> str:
    """Wrap a line, the rest indented below its value; a fact's value begins after two spaces."""
    if not 40 <= width < len(line):
        return line
    name = re.match(r"  \S.*?  +", line)
    indent = len(name[0]) if name else 2
    return fill(line, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False)


def print_json(result: dict[str, Any]) -> None:
    """Print a result as one JSON object on stdout."""
    print(json_line(result), flush=True)


def opened(target: str) -> bool:
    """Open a file or an address with the program that the desktop has for it; False: there is none."""
    import webbrowser

    path = Path(target)
    return webbrowser.open(path.resolve().as_uri() if path.exists() else target)
