"""Plain help pages: options in groups, no name ever cut, 80 columns, quick to print.

Every option of a verb that takes a value names it by a `metavar`, and its group by `rich_help_panel`.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from enum import Enum
from typing import Any

from typer.core import TyperCommand, TyperGroup

OUTPUT, MACHINE, ACCURACY, SPEED, ADVANCED = "Output", "Machine and bed", "Accuracy", "Speed", "Advanced"
FASTER, REACH = "A quicker print", "Who reaches it"
GROUPS = (REACH, OUTPUT, MACHINE, ACCURACY, FASTER, SPEED, ADVANCED)  # in the order in which they are printed
NAME_COLUMNS = 26  # a longer name stands on a line of its own
SETTINGS = {"help_option_names": ["-h", "--help"]}

Row = tuple[str, str]


class Command(TyperCommand):
    """A verb whose help is plain text in groups."""

    def format_usage(self, ctx: Any, formatter: Any) -> None:
        """Write the usage line, of help pages and of usage errors."""
        _write_usage(self, ctx, formatter)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the usage, the text, the arguments and the options by group."""
        _write_head(self, ctx, formatter)
        parameters = [each for each in self.get_params(ctx) if not getattr(each, "hidden", False)]
        _write_rows(formatter, "Arguments", [_row(each) for each in parameters if _is_argument(each)])
        for group in (*GROUPS, None):
            rows = [_row(each) for each in parameters if not _is_argument(each) and _group(each) == group]
            _write_rows(formatter, group or "Other", rows)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words; `--robust auto` is the same as nothing."""
        auto = (i for i, word in enumerate(args) if word == "--robust=auto" or args[i : i + 2] == ["--robust", "auto"])
        if (at := next(auto, None)) is not None:
            del args[at : at + (1 if "=" in args[at] else 2)]
        return list(super().parse_args(ctx, args))

    def invoke(self, ctx: Any) -> Any:
        """Run the verb; say first what is missing for a figure or a page, or why a first run takes longer."""
        from ffcomp.cli.common import require, say
        from ffcomp.cli.compiled import VERBS, first_run, note_compiled, sentence

        if any(ctx.params.get(option) for option in ("figure", "report")):
            require("matplotlib")
        verb = ctx.info_name
        compiles = verb in VERBS and first_run(verb)
        if compiles:
            say(f"ffcomp: {sentence(verb)}", bool(ctx.params.get("quiet")))
        done = super().invoke(ctx)
        if compiles:
            note_compiled(verb)
        return done


class Group(TyperGroup):
    """A verb that holds verbs."""

    def format_usage(self, ctx: Any, formatter: Any) -> None:
        """Write the usage line, of help pages and of usage errors."""
        _write_usage(self, ctx, formatter)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the usage, the text, the verbs and the options."""
        _write_head(self, ctx, formatter)
        verbs = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
        _write_rows(formatter, "Verbs", [(name, _first_line(verb)) for name, verb in verbs if verb and not verb.hidden])
        _write_rows(formatter, "Options", [_row(each) for each in self.get_params(ctx)])

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the verbs in the order in which they are registered."""
        return list(self.commands)


def _write_usage(command: Any, ctx: Any, formatter: Any) -> None:
    arguments = [f"{each.metavar or each.name.upper()}" for each in command.get_params(ctx) if _is_argument(each)]
    verbs = ["VERB"] if isinstance(command, TyperGroup) else []
    formatter.write_usage(ctx.command_path, " ".join([*arguments, *verbs, "[OPTIONS]"]))


def _write_head(command: Any, ctx: Any, formatter: Any) -> None:
    command.format_usage(ctx, formatter)
    for paragraph in (command.help or "").split("\n\n"):
        formatter.write_paragraph()
        words = " ".join(paragraph.split())
        for line in textwrap.wrap(words, formatter.width - 2, break_on_hyphens=False, break_long_words=False):
            formatter.write(f"  {line}\n")


def _write_rows(formatter: Any, title: str, rows: list[Row]) -> None:
    if rows:
        with formatter.section(title):
            formatter.write_dl(rows, col_max=NAME_COLUMNS)


def _is_argument(parameter: Any) -> bool:
    return bool(parameter.param_type_name == "argument")


def _group(parameter: Any) -> str | None:
    return getattr(parameter, "rich_help_panel", None)


def _first_line(command: Any) -> str:
    return " ".join((command.help or "").split("\n\n")[0].split())


def _row(parameter: Any) -> Row:
    text = " ".join([parameter.help or "", *_notes(parameter)]).strip()
    if _is_argument(parameter):
        return parameter.metavar or parameter.name.upper(), text
    names = ", ".join(sorted(parameter.opts, key=len))
    if parameter.secondary_opts:
        names += " / " + ", ".join(parameter.secondary_opts)
    return (names if parameter.is_flag else f"{names} {parameter.metavar}"), text


def _notes(parameter: Any) -> Iterator[str]:
    """State what is required, the default, the bounds and the environment variable, in brackets."""
    if parameter.envvar:
        yield f"[env: {parameter.envvar}]"
    if parameter.required:
        if not _is_argument(parameter):
            yield "[required]"
        return
    low, high = _bounds(parameter)
    if low is not None and high is not None:
        yield f"[{low:g} to {high:g}]"
    if (default := _default(parameter)) != "":
        yield f"[default: {default}]"


def _bounds(parameter: Any) -> tuple[float | None, float | None]:
    """Find the bounds of a number: Typer keeps them on the parameter, older versions on its type."""
    holder = parameter if hasattr(parameter, "min") else getattr(parameter, "type", None)
    return getattr(holder, "min", None), getattr(holder, "max", None)


def _default(parameter: Any) -> str:
    value = parameter.default
    if value is None or callable(value) or value == "" or value == () or value == []:
        return ""
    if isinstance(value, bool):
        names = parameter.opts if value else parameter.secondary_opts
        return names[0].lstrip("-") if parameter.secondary_opts else ""
    if isinstance(value, float):
        return "" if math.isinf(value) else f"{value:g}"
    return str(value.value if isinstance(value, Enum) else value)
