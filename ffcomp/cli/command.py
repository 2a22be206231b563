"""Make commands of requests with cyclopts: options, help pages, checks and exit codes of every verb.

`ffcomp.request` says how a verb is declared.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from cyclopts import App, CycloptsError, Group, MissingArgumentError, Parameter

from ffcomp.cli.common import answer, exit_codes, machine_errors, quiet, report, require, say
from ffcomp.cli.progress import Event
from ffcomp.errors import RequestError
from ffcomp.request import FORCE, GROUPS, OUTPUT, Declared, Option, Request, declared
from ffcomp.result import Result

COMPILING = "Compiling once, up to a minute; later runs reuse the result"
HELP_FLAGS = ("--help", "-h")
ARGUMENTS = Group("Arguments", sort_key=0)
OPTIONS = {name: Group(name, sort_key=1 + number) for number, name in enumerate(GROUPS)}
OTHER = Group("Other", sort_key=99)


@dataclass(frozen=True, kw_only=True)
class Shown(Request):
    """What every verb with an answer prints."""

    as_json: Annotated[bool, Option("Print one JSON object on stdout.", OUTPUT, "--json")] = False
    quiet: Annotated[bool, Option("Print no progress.", OUTPUT, "--quiet -q")] = False
    report: Annotated[
        Path | None,
        Option("Write answer and figures as one HTML page.", OUTPUT, "--report -r", metavar="FILE", writes="file"),
    ] = None


def verb(work: Callable[..., Result | None]) -> App:
    """Make the command of a function that takes one or more requests, and prints the result that it returns.

    Its name is the first word of the function's, its help page the function's text.
    """
    hints, signature = get_type_hints(work), inspect.signature(work)
    name = work.__name__.partition("_")[0]
    requests: list[type[Request]] = [hints[name] for name in signature.parameters]
    shown = [Shown] if hints["return"] is Result else []
    options = [each for request in (*requests, *shown) for each in declared(request)]
    signature = inspect.Signature([_parameter(each) for each in sorted(options, key=_kind)])

    def call(*args: Any, **kwargs: Any) -> None:
        from models.compiled import BEFORE_COMPILING

        with exit_codes():
            values = signature.bind(*args, **kwargs).arguments
            made = [_made(request, values) for request in requests]
            check_targets([*made, *(_made(each, values) for each in shown)])
            if any(values.get(option) for option in ("figure", "report")):
                require("matplotlib")
            with quiet(bool(values.get("quiet"))), machine_errors(bool(values.get("as_json"))):
                BEFORE_COMPILING[:] = [partial(copy_context().run, _say_compiling)]  # in threads as well, it is quiet
                result = work(*made)
            if result is not None:
                for option, write in (("figure", result.write_figure), ("report", result.write_report)):
                    if values.get(option):
                        write(values[option])
                        report(str(values[option]))
                answer(result, bool(values.get("as_json")))

    call.__signature__, call.options = signature, options  # type: ignore[attr-defined]
    app = App(name=name, help=paragraphs(inspect.cleandoc(work.__doc__ or "")), **SETTINGS)
    app.default(call)
    return app


def _say_compiling() -> None:
    report(f"{COMPILING}.")
    Event(COMPILING).write()


SETTINGS: dict[str, Any] = {
    "help_flags": HELP_FLAGS,
    "help_format": "plaintext",
    "version_flags": (),
    "result_action": "return_value",
    "group_arguments": ARGUMENTS,
    "group_parameters": OTHER,
    "group_commands": Group("Verbs", sort_key=0),
    "default_parameter": Parameter(negative_iterable=(), allow_repeating=True),
}


def check_targets(requests: Sequence[Request]) -> None:
    """Raise RequestError, before the work, for targets that cannot be written or must not be.

    A target lies in a folder that exists, is no file that is read, and no other target. Where a verb has --force,
    nothing that exists is overwritten without it.
    """
    stated = [(each, getattr(request, each.field)) for request in requests for each in declared(type(request))]
    read = {path.resolve() for each, value in stated if not each.option.writes for path in _paths_in(each, value)}
    force = next((value for each, value in stated if each.option is FORCE), True)
    written = set[Path]()
    for each, value in stated:
        for path in _paths_in(each, value) if each.option.writes else ():
            name, folder = each.names[0], each.option.writes == "folder"
            if folder and path.exists() and not path.is_dir():
                raise RequestError(f"{path}: {name} names a folder.")
            if not folder and (path.is_dir() or not path.resolve().parent.is_dir()):
                raise RequestError(f"{path}: {name} names a file in a folder that exists.")
            if name == "--report" and path.suffix.lower() not in (".html", ".htm"):
                raise RequestError(f"{path}: --report writes a page; end its name in .html.")
            if path.resolve() in read:
                raise RequestError(f"{path} is read as well; give another {name}.")
            if path.resolve() in written:
                raise RequestError(f"{path} is named twice; give another {name}.")
            if path.exists() and not folder and not force:
                raise RequestError(f"{path} exists already; give another {name}, or --force.")
            written.add(path.resolve())


def _paths_in(option: Declared, value: Any) -> list[Path]:
    values = value if isinstance(value, tuple) else (value,)
    kinds = (str, Path) if option.option.positional or option.option.writes else Path
    return [Path(each) for each in values if isinstance(each, kinds)]


def _made(request: type[Request], values: dict[str, Any]) -> Request:
    made = {}
    for each in declared(request):
        if each.field in values:
            value = values[each.field]
            made[each.field] = value if each.option.parse is None else each.option.parse(value)
    return request(**made)


def _kind(each: Declared) -> Any:
    if not each.option.positional:
        return inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter.VAR_POSITIONAL if each.many else inspect.Parameter.POSITIONAL_ONLY


def _parameter(each: Declared) -> inspect.Parameter:
    """Return the parameter that cyclopts makes an option of."""
    option, kind = each.option, _kind(each)
    notes = [f"[{words}]" for words in (", ".join(option.choices), each.range) if words]
    how = Parameter(
        name=(option.metavar.rstrip("."),) if option.positional else each.names,
        negative=each.negative or (),
        help=" ".join([option.help, *notes]),
        group=ARGUMENTS if option.positional else OPTIONS.get(option.group, OTHER),
        metavar=option.metavar or None,
        env_var=option.env or None,
        show_default=(lambda value: each.default_text) if each.default_text else False,
        required=each.required,
        allow_leading_hyphen=not option.positional,  # -110,-110 is a value
    )
    one = each.item_type
    if kind is inspect.Parameter.VAR_POSITIONAL:
        return inspect.Parameter(each.field, kind, annotation=Annotated[one, how])
    default = inspect.Parameter.empty if each.required else each.default if each.option.parse is None else None
    annotated = tuple[one, ...] if each.many else one  # type: ignore[valid-type]
    return inspect.Parameter(each.field, kind, default=default, annotation=Annotated[annotated | None, how])


def group(name: str, text: str, *verbs: App, **settings: Any) -> App:
    """Make a command that holds others, which its help shows in this order."""
    app = App(name=name, help=paragraphs(text), **SETTINGS | settings)
    for number, each in enumerate(verbs):
        each.sort_key = number
        app.command(each)
    return app


def commands(app: App, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], App, list[Declared]]]:
    """Return the words, the command and the options of every verb; groups have no options."""
    yield path, app, getattr(app.default_command, "options", [])
    for name in app:
        if name not in (*HELP_FLAGS, "--version", "--log-path"):
            yield from commands(app[name], (*path, name))


def paragraphs(text: str) -> str:
    """Join the lines of each paragraph; cyclopts wraps them to the terminal's width."""
    return "\n\n".join(" ".join(each.split()) for each in text.split("\n\n"))


def run(app: App, words: list[str]) -> None:
    """Run the command line; wrong usage ends with a sentence and exit code 2."""
    try:
        _, apps, rest = app.parse_commands(words)
        if not rest and apps[-1].default_command is None:
            app.help_print(words, console=app.error_console)
            raise SystemExit(2)
        app(words, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        say(f"ffcomp: {_usage(error)} See: {' '.join(['ffcomp', *(error.command_chain or ())])} --help.")
        raise SystemExit(2) from None


def _usage(error: CycloptsError) -> str:
    if isinstance(error, MissingArgumentError) and error.argument is not None and not error.argument.tokens:
        names = " (a name of ffcomp machines list, or a file)" if error.argument.name == "--machine" else ""
        return f"{error.argument.name} is missing{names}."
    return str(error).strip()
