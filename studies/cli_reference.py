"""docs/reference/cli.md, written from the verbs themselves: their requests and docstrings."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cyclopts import App

from ffcomp.cli.app import app
from ffcomp.cli.command import commands
from ffcomp.request import Declared
from studies.render import print_or_write

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "cli.md"
WORDS = {str: "TEXT", Path: "PATH", int: "WHOLE NUMBER", float: "NUMBER"}

HEAD = """\
# Command line

Written by `python -m studies.cli_reference --write` from the verbs themselves; a test holds it to them.
`ffcomp VERB --help` says the same in the terminal.

What holds for all verbs:

- A **machine** is a name (`ffcomp machines list`) or the path of a TOML file ([its format](machine_file.md)). What ends
  in `.toml` or holds a folder separator is a path. Your own machine folder goes before the library.
- A **print** may be `.gcode`, `.gcode.gz`, `.gcode.3mf` or `.bgcode`. The content decides, not the name.
- **Results** go to stdout, messages and progress to stderr. `--json` prints one object ([every key](json.md)).
- Every run ends with one of a few [exit codes](files.md#exit-codes) and is noted in the log there.
- Options may stand before or after the files. An option that may be given again is repeated with its name:
  `--at 0,0 --at 40,0`.
"""


@dataclass(frozen=True)
class Verb:
    name: str  # "identify fit"
    text: list[str]  # its docstring, a paragraph each, without the example
    example: str  # empty if there is none
    options: list[Declared]


def verbs() -> list[Verb]:
    """Every verb, in the order of `ffcomp --help`."""
    return [_verb(path, command.help, options) for path, command, options in commands(app) if command.default_command]


def sections(command: App) -> list[str]:
    """The lines of a command of its own."""
    return [line for path, each, options in commands(command) for line in _section(_verb(path, each.help, options))]


def _verb(path: tuple[str, ...], text: str, options: list[Declared]) -> Verb:
    paragraphs = text.split("\n\n")
    examples = [each.removeprefix("Example: ") for each in paragraphs if each.startswith("Example: ")]
    others = [each for each in paragraphs if not each.startswith("Example: ")]
    return Verb(" ".join(path), others, examples[0] if examples else "", options)


def page() -> str:
    found = verbs()
    lines = [HEAD, "| verb | what it does |", "|---|---|"]
    lines += [f"| [`{verb.name}`](#{_anchor(verb)}) | {_safe(verb.text[0])} |" for verb in found]
    lines += ["", "## ffcomp", "", "Options that stand before the verb.", "", "| option | meaning |", "|---|---|"]
    lines += ["| `--version` | Show the version and exit. |"]
    lines += ["| `--log-path` | Show where every run is logged and exit. |", ""]
    for verb in found:
        lines += _section(verb)
    return "\n".join(lines).rstrip("\n") + "\n"


def _anchor(verb: Verb) -> str:
    return f"ffcomp-{verb.name.replace(' ', '-')}"


def _section(verb: Verb) -> Iterator[str]:
    yield from (f"## ffcomp {verb.name}", "", f"`{_usage(verb)}`", "")
    for paragraph in verb.text:
        yield from (*textwrap.wrap(_safe(paragraph), 120, break_on_hyphens=False), "")
    if verb.example:
        yield from (f"Example: `{verb.example}`", "")
    if verb.options:
        yield from (*_table(verb.options), "")


def _usage(verb: Verb) -> str:
    arguments = [each.option.metavar for each in verb.options if each.option.positional]
    needed = [f"{each.names[0]} {each.option.metavar}" for each in verb.options if _is_needed(each)]
    free = any(not each.option.positional and not each.required for each in verb.options)
    return " ".join(["ffcomp", verb.name, *arguments, *needed, *(["[options]"] if free else [])])


def _is_needed(each: Declared) -> bool:
    return each.required and not each.option.positional


def _table(options: list[Declared]) -> Iterator[str]:
    yield "| option | takes | default | meaning |"
    yield "|---|---|---|---|"
    for each in options:
        positional = each.option.positional
        names = [each.option.metavar] if positional else [f"`{name}`" for name in (*each.names, each.negative) if name]
        default = "**required**" if each.required else _default(each)
        help_text = each.option.help + (f" Or the environment variable {each.option.env}." if each.option.env else "")
        yield f"| {', '.join(names)} | {_safe('' if positional else _value(each))} | {default} | {_safe(help_text)} |"


def _value(each: Declared) -> str:
    if each.is_switch:
        return ""
    choices = [str(choice) for choice in each.choices]
    return ", ".join([*(choices or [each.option.metavar]), *([each.range] if each.range else [])])


def _default(each: Declared) -> str:
    text = "on" if each.default is True else each.default_text
    return text and f"`{text}`"


def _safe(text: str) -> str:
    """What Markdown would take for markup, as it is."""
    return re.sub(r"([*<|])", r"\\\1", text)


if __name__ == "__main__":
    print_or_write(page(), PAGE)
