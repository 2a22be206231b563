"""docs/reference/cli.md, written from the verbs themselves: their signatures, help texts and docstrings."""

from __future__ import annotations

import inspect
import math
import re
import sys
import textwrap
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import typer
from typer.models import ArgumentInfo, OptionInfo

from ffcomp.cli.app import app, options

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
- Every run ends with one of a few [exit codes](exit_codes_and_log.md) and is noted in the log there.
- Options may stand before or after the files. An option that may be given again is repeated with its name:
  `--at 0,0 --at 40,0`.
"""


@dataclass(frozen=True)
class Parameter:
    """One option or argument of a verb."""

    name: str  # as typed, all ways: `--machine`, `-m`
    value: str  # what it takes; empty for a switch
    default: str
    help: str
    is_argument: bool
    required: bool


@dataclass(frozen=True)
class Verb:
    name: str  # "identify fit"
    text: list[str]  # its docstring, a paragraph each, without the example
    example: str  # empty if there is none
    parameters: list[Parameter]


def verbs() -> list[Verb]:
    """Every verb, in the order of `ffcomp --help`."""
    return list(_verbs(app, ""))


def _verbs(group: typer.Typer, prefix: str) -> Iterator[Verb]:
    for command in group.registered_commands:
        function = command.callback
        assert function is not None
        name = command.name or function.__name__
        yield _verb(function, f"{prefix}{name}")
    for inner in group.registered_groups:
        assert inner.typer_instance is not None
        yield from _verbs(inner.typer_instance, f"{prefix}{inner.name} ")


def _verb(function: Callable[..., Any], name: str) -> Verb:
    paragraphs = [re.sub(r"\s+", " ", text) for text in inspect.cleandoc(function.__doc__ or "").split("\n\n")]
    examples = [text.removeprefix("Example: ") for text in paragraphs if text.startswith("Example: ")]
    text = [text for text in paragraphs if not text.startswith("Example: ")]
    return Verb(name, text, examples[0] if examples else "", parameters(function))


def parameters(function: Callable[..., Any]) -> list[Parameter]:
    hints = get_type_hints(function, include_extras=True)
    return [_parameter(each, hints[each.name]) for each in inspect.signature(function).parameters.values()]


def _parameter(said: inspect.Parameter, annotation: Any) -> Parameter:
    kind, info = get_args(annotation)
    assert isinstance(info, ArgumentInfo | OptionInfo)
    kind = _plain(kind)
    required = said.default is inspect.Parameter.empty
    default = "" if required else _default(said.default)
    help_text = info.help or ""
    if info.envvar:
        help_text += f" Or the environment variable {info.envvar}."
    if isinstance(info, ArgumentInfo):
        return Parameter(info.metavar or said.name.upper(), "", default, help_text, True, required)
    names = " ".join(_names(said.name, kind, info))
    return Parameter(names, _value(kind, info), default, help_text, False, required)


def _plain(kind: Any) -> Any:
    """X of `X | None` and of `list[X]`."""
    if get_origin(kind) in (Union, types.UnionType):
        kind = next(each for each in get_args(kind) if each is not type(None))
    return get_args(kind)[0] if get_origin(kind) is list else kind


def _names(name: str, kind: Any, info: OptionInfo) -> list[str]:
    """As they are declared (Typer keeps the first of them as `default`), else made of the parameter's name."""
    declared = [each for each in (info.default, *(info.param_decls or ())) if isinstance(each, str)]
    long = f"--{name.replace('_', '-')}"
    made = [long, f"--no-{long[2:]}"] if kind is bool else [long]
    return sorted(declared, key=len, reverse=True) or made


def _value(kind: Any, info: OptionInfo) -> str:
    if kind is bool:
        return ""
    if issubclass(kind, Enum):
        return ", ".join(each.value for each in kind)
    word = info.metavar or WORDS[kind]
    ends = [f"at least {info.min:g}"] if info.min is not None else []
    ends += [f"at most {info.max:g}"] if info.max is not None else []
    return ", ".join([word, *ends])


def _default(value: Any) -> str:
    if value is None or value == "" or value is False or (isinstance(value, float) and math.isinf(value)):
        return ""
    return "on" if value is True else f"{value:g}" if isinstance(value, float) else str(value)


def page() -> str:
    found = verbs()
    lines = [HEAD, "| verb | what it does |", "|---|---|"]
    lines += [f"| [`{verb.name}`](#{_anchor(verb)}) | {_safe(verb.text[0])} |" for verb in found]
    lines += ["", "## ffcomp", "", "Options that stand before the verb.", "", *_table(parameters(options)), ""]
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
    if verb.parameters:
        yield from (*_table(verb.parameters), "")


def _usage(verb: Verb) -> str:
    arguments = [each.name for each in verb.parameters if each.is_argument]
    needed = [f"{each.name.split()[0]} {each.value}" for each in verb.parameters if _is_needed(each)]
    free = any(not each.is_argument and not each.required for each in verb.parameters)
    return " ".join(["ffcomp", verb.name, *arguments, *needed, *(["[options]"] if free else [])])


def _is_needed(each: Parameter) -> bool:
    return each.required and not each.is_argument


def _table(rows: list[Parameter]) -> Iterator[str]:
    yield "| option | takes | default | meaning |"
    yield "|---|---|---|---|"
    for row in rows:
        names = row.name if row.is_argument else ", ".join(f"`{name}`" for name in row.name.split())
        default = "**required**" if row.required else row.default and f"`{row.default}`"
        yield f"| {names} | {_safe(row.value)} | {default} | {_safe(row.help)} |"


def _safe(text: str) -> str:
    """What Markdown would take for markup, as it is."""
    return re.sub(r"([*<|])", r"\\\1", text)


def main() -> None:
    if sys.argv[1:] == ["--write"]:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")


if __name__ == "__main__":
    main()
