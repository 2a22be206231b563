"""Examples in Markdown pages: found, told apart, run as a reader would, and held to the output that the page quotes.

A fenced block is run if its language is `sh` or `console` (commands) or `python`. In `console` blocks commands begin
with `$ ` and what stands below one is its output. `# exit 5` behind a command says how it ends; without it, with 0.
A block that no test can run says why, in a comment right before its fence: <!-- not run: it needs a printer -->.
"""

from __future__ import annotations

import glob
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from cyclopts import CycloptsError

from ffcomp.cli.app import app
from tests.support.cli import CliRunner

ROOT = Path(__file__).parents[2]
COMMANDS = ("sh", "console")
FENCE = re.compile(r"^( *)```(\w*)[^`]*$")
REASON = re.compile(r"<!-- not run: (.+?) -->$")
EXIT = re.compile(r"# exit (\d+)")
NUMBER = re.compile(r"\d+(?:\.\d+)?")
CLOSE = 0.02  # share by which a quoted number may be off: other computers round differently
SHIM = "#!/bin/sh\nexec {python} -c 'from ffcomp.cli.app import main; main()' \"$@\"\n"


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    page: Path
    line: int  # of its first line of text, counted from 1
    language: str
    lines: list[str]
    not_run: str  # why; empty if it is run

    @property
    def text(self) -> str:
        return "\n".join(self.lines) + "\n"

    @property
    def is_example(self) -> bool:
        return self.language in (*COMMANDS, "python") and not self.not_run

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


@dataclass(frozen=True)
class Command:
    """One command of a block, with the output that the page quotes."""

    text: str
    exit_code: int
    quoted: list[str] = field(default_factory=list)


def pages() -> list[Path]:
    """Every page that users read, and the reports of studies."""
    docs, reports = (ROOT / "docs").rglob("*.md"), (ROOT / "studies" / "reports").glob("*.md")
    return [ROOT / "README.md", *sorted(docs), *sorted(reports)]


def blocks_of(page: Path) -> list[Block]:
    """Every fenced block of a page, in order."""
    return list(_blocks(page, page.read_text(encoding="utf-8").splitlines()))


def _blocks(page: Path, lines: list[str]) -> Iterator[Block]:
    numbered = iter(enumerate(lines, 1))
    before = ""
    for number, line in numbered:
        if fence := FENCE.match(line):
            indent = len(fence[1])
            body = []
            for _, inner in numbered:
                if inner.strip() == "```":
                    break
                body.append(inner[indent:])
            else:
                raise AssertionError(f"{page.name}:{number}: this block is never closed.")
            reason = REASON.search(before)
            yield Block(page, number + 1, fence[2], body, reason[1] if reason else "")
        before = line.strip() or before


def commands_of(block: Block) -> list[Command]:
    """What a reader would type, one by one; lines that end in a backslash go on."""
    joined = re.sub(r"\\\n\s*", "", block.text).splitlines()
    found: list[Command] = []
    for line in filter(str.strip, joined):
        is_command = line.startswith("$ ") if block.language == "console" else not line.startswith("#")
        if is_command:
            ends = EXIT.search(line)
            found.append(Command(line.removeprefix("$ "), int(ends[1]) if ends else 0))
        elif block.language == "console":
            if not found:
                raise AssertionError(f"{block.place}: output stands before any command, which begins with '$ '.")
            found[-1].quoted.append(line)
    return found


# ---- parsed, not run -----------------------------------------------------------------------------


def usage_error(command: str) -> str | None:
    """What ffcomp would say of a wrong verb, option or value of a command line, which is read and not run."""
    words = shlex.split(command, comments=True)[1:]
    try:
        app.parse_args(words, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        return str(error)
    return None


# ---- run -----------------------------------------------------------------------------------------


def lay_out(folder: Path) -> None:
    """What a reader has before them: the examples, the sample prints, and a folder for their own machine files."""
    shutil.copytree(ROOT / "docs" / "examples", folder, dirs_exist_ok=True)
    shutil.copytree(ROOT / "docs" / "examples", folder / "docs" / "examples")
    shutil.copytree(ROOT / "sample_prints", folder / "sample_prints")
    shim = folder / "bin" / "ffcomp"
    shim.parent.mkdir()
    shim.write_text(SHIM.format(python=shlex.quote(sys.executable)))
    shim.chmod(0o755)


def environment(folder: Path) -> dict[str, str]:
    """Of the commands of a page; the reader's own settings stay out of it."""
    path = os.pathsep.join((str(folder / "bin"), os.environ.get("PATH", "")))
    modules = os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))
    return {"XDG_CONFIG_HOME": str(folder / "config"), "COLUMNS": "80", "PATH": path, "PYTHONPATH": modules}


def run_block(block: Block) -> None:
    """Run a block in the current folder; everything it says must be true.

    Raises
    ------
    AssertionError
        With the place, the command and what it printed, if it ends or prints otherwise than the page says.
    """
    if block.language == "python":
        exec(compile(block.text, block.place, "exec"), {"__name__": "__main__"})
        return
    for command in commands_of(block):
        code, output = _run(command.text)
        said = f"{block.place}: {command.text}\n{output}"
        assert code == command.exit_code, f"exit code {code}, not {command.exit_code}: {said}"
        missing = first_missing(command.quoted, output)
        assert missing is None, f"the page quotes {missing!r}: {said}"


def _run(text: str) -> tuple[int, str]:
    words = shlex.split(text, comments=True)
    if words[0] == "ffcomp" and not {"|", "&&", ";"} & set(words):
        return run_here(words[1:])
    done = subprocess.run(["sh", "-c", text], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def run_here(words: list[str]) -> tuple[int, str]:
    """Exit code and output of ffcomp in this process, which has compiled and loaded everything already."""
    target = None
    if ">" in words:
        at = words.index(">")
        target, words = Path(words[at + 1]), words[:at]
    expanded = [name for word in words for name in sorted(glob.glob(word)) or [word]]
    result = CliRunner().invoke(app, expanded)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    if target is not None:
        target.write_text(result.stdout, encoding="utf-8")
    return result.exit_code, result.output


# ---- quoted output -------------------------------------------------------------------------------


def first_missing(quoted: list[str], output: str) -> str | None:
    """The first quoted line that the output does not hold, in order; lines may be left out with or without `…`."""
    actual = iter(output.splitlines())
    for line in quoted:
        if line.strip() != "…" and not any(matches(line, other) for other in actual):
            return line
    return None


def matches(quoted: str, actual: str) -> bool:
    """Spaces count as one, `…` stands for anything, and numbers may differ in what other computers round."""
    pieces = [_pattern(piece) for piece in " ".join(quoted.split()).split("…")]
    found = re.fullmatch(".*".join(pieces), " ".join(actual.split()))
    if not found:
        return False
    numbers = NUMBER.findall(quoted)
    return all(_close(told, got) for told, got in zip(numbers, found.groups(), strict=True))


def _pattern(text: str) -> str:
    return r"(\d+(?:\.\d+)?)".join(re.escape(part) for part in NUMBER.split(text))


def _close(told: str, got: str) -> bool:
    """Within two percent, or one unit of the last digit."""
    unit = 10.0 ** -len(told.partition(".")[2])
    return abs(float(told) - float(got)) <= max(CLOSE * float(told), 1.001 * unit)
