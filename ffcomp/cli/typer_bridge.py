"""Commands of verbs that are still declared with Typer; it goes with the last of them."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable
from dataclasses import MISSING
from functools import partial
from typing import Any, Union, get_args, get_origin, get_type_hints

import typer
from cyclopts import App
from typer.models import ArgumentInfo, OptionInfo

from ffcomp.cli.command import command, group
from ffcomp.errors import RequestError
from ffcomp.request import Argument, Declared, Option


def bridged(function: Callable[..., None], name: str = "") -> App:
    """Make the command of a function that Typer's annotations declare."""
    hints = get_type_hints(function, include_extras=True)
    options = [_declared(each, hints[each.name]) for each in inspect.signature(function).parameters.values()]

    def prepare(values: dict[str, Any]) -> Callable[[], None]:
        for each in options:
            if isinstance(values.get(each.field), tuple):
                values[each.field] = list(values[each.field])
            elif each.field in values and values[each.field] is not None:
                each.check(values[each.field])
        return partial(run, values)

    def run(values: dict[str, Any]) -> None:
        try:
            function(**values)
        except typer.BadParameter as error:
            raise RequestError(error.message) from None
        except typer.Exit as end:
            raise SystemExit(end.exit_code) from None

    return command(name or function.__name__, inspect.cleandoc(function.__doc__ or ""), options, prepare)


def bridged_app(source: typer.Typer, name: str) -> App:
    """Make the command of a Typer app, with those in it."""
    verbs = [
        bridged(each.callback, each.name or each.callback.__name__.replace("_", "-"))
        for each in source.registered_commands
        if each.callback is not None
    ]
    return group(name, inspect.cleandoc(str(source.info.help)), *verbs)


def _declared(said: inspect.Parameter, annotation: Any) -> Declared:
    kind, info = get_args(annotation)
    assert isinstance(info, ArgumentInfo | OptionInfo)
    if get_origin(kind) in (Union, types.UnionType):
        kind = next(each for each in get_args(kind) if each is not type(None))
    if get_origin(kind) is list:
        kind = tuple[get_args(kind)[0], ...]  # type: ignore[misc]
    declarations = [each for each in (info.default, *(info.param_decls or ())) if isinstance(each, str)]
    names = [name.partition("/")[0] for name in sorted(declarations, key=len, reverse=True)]
    option = (Argument if isinstance(info, ArgumentInfo) else Option)(
        info.help or "",
        info.rich_help_panel or "",
        *names,
        metavar=info.metavar or (said.name.upper() if isinstance(info, ArgumentInfo) else ""),
        low=info.min,
        high=info.max,
        env=str(info.envvar or ""),
    )
    default = MISSING if said.default is inspect.Parameter.empty else said.default
    return Declared(said.name, kind, default, option)
