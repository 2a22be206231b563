"""Declare a verb once: command line, Python, browser page and reference are made from the declaration.

The request of a verb is one frozen dataclass. A field gives an option's name, type and default; the `Option` in its
annotation gives the rest: help, group and range.

To add an option, add a field to the verb's request and use it where the verb does its work:

    layers: Annotated[int, Option("Layers to restore.", OUTPUT, metavar="N", low=1)] = 1

To add a verb, write its request, a function with `@verb` in `ffcomp/cli/` whose docstring is the help (heavy imports
wait inside it), a row of `VERBS` in `ffcomp/cli/app.py`, and its Python function in `ffcomp/api/`, made by `function`.

Names: `--the-field` unless the Option names others. A `bool` is a switch; `--no-…` exists if its default is True or
None. A `tuple[X, ...]` may be repeated. A type that cannot be made from text directly has a `parse`. The page of
`ffcomp serve` offers the options that have a `label`. A field without an Option is for Python only; a text in its
annotation describes it. Ranges and choices (`Literal`) are checked whenever a request is made; rules that involve
several fields go into `check`.
"""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, dataclass, fields
from math import isinf
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    ParamSpec,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from ffcomp.errors import INPUT_ERRORS, RequestError, explain

if TYPE_CHECKING:
    from models.machine import Machine

    MachineLike = str | Path | Machine
else:  # as the command line reads them
    MachineLike = str | Path | object

P = ParamSpec("P")
Q = TypeVar("Q")
R = TypeVar("R")

OUTPUT, MACHINE, ACCURACY, SPEED, ADVANCED = "Output", "Machine and bed", "Accuracy", "Speed", "Advanced"
FASTER, REACH = "A quicker print", "Who can reach it"
GROUPS = (REACH, OUTPUT, MACHINE, ACCURACY, FASTER, SPEED, ADVANCED)  # in the order of the help


@dataclass(eq=False, repr=False)
class Option:
    """The description of an option, in addition to its field's name, type and default."""

    help: str  # one sentence
    group: str = ""  # one of GROUPS
    names: str = ""  # on the command line, e.g. `--output -o`; none: `--the-field`
    _: KW_ONLY
    metavar: str = ""  # placeholder for the value in help
    low: float | None = None  # smallest value
    high: float | None = None  # largest value
    choices: tuple[str, ...] = ()  # the allowed values, if its type is not a Literal
    env: str = ""  # environment variable that is read if the command line does not set the option
    # makes the value from the text on the command line, or from all texts of a repeated option; raises RequestError
    parse: Callable[[Any], Any] | None = None
    repeated: bool = False  # whether `parse` takes all the texts of an option that may be repeated
    unset: str = ""  # text for a default that has none of its own
    writes: Literal["", "file", "folder"] = ""  # of a path that is written
    label: str = ""  # its name on the page of `ffcomp serve`; none: it is not offered there
    positional: ClassVar[bool] = False


class Argument(Option):
    """A value that stands on the command line without a name; a tuple takes all of them."""

    positional: ClassVar[bool] = True


@dataclass(frozen=True)
class Declared:
    """One option of a request: its field and its `Option` together."""

    field: str
    type: Any
    default: Any  # MISSING: required
    option: Option

    @property
    def required(self) -> bool:
        """Whether it must be stated."""
        return self.default is MISSING

    @property
    def default_text(self) -> str:
        """The default as a person writes it; empty where that says nothing."""
        value = self.default
        if self.option.parse is not None or value is None or value is MISSING or isinstance(value, bool):
            return self.option.unset
        if value in ("", ()):
            return ""
        if isinstance(value, float):
            return "" if isinf(value) else f"{value:g}"
        return str(value)

    @property
    def names(self) -> tuple[str, ...]:
        """Names on the command line, the long one first."""
        return tuple(self.option.names.split()) or (f"--{self.field.replace('_', '-')}",)

    @property
    def plain_type(self) -> Any:
        """The first type of a union that is not None, e.g. `str` of `str | Path | None`."""
        if get_origin(self.type) in (Union, types.UnionType):
            return next(each for each in get_args(self.type) if each is not type(None))
        return self.type

    @property
    def is_switch(self) -> bool:
        """Whether it takes no value."""
        return self.plain_type is bool and self.option.parse is None

    @property
    def many(self) -> bool:
        """Whether it may be stated more than once."""
        return self.holds_several if self.option.parse is None else self.option.repeated

    @property
    def holds_several(self) -> bool:
        """Whether its value is a tuple of any length."""
        return get_origin(self.plain_type) is tuple and get_args(self.plain_type)[-1] is Ellipsis

    @property
    def item_type(self) -> Any:
        """The type of one value, as the command line reads it."""
        if self.option.parse is not None:
            return str
        return get_args(self.plain_type)[0] if self.many else self.plain_type

    @property
    def negative(self) -> str:
        """The name that switches it off; empty: none."""
        return f"--no-{self.names[0][2:]}" if self.is_switch and self.default is not False else ""

    @property
    def choices(self) -> tuple[Any, ...]:
        """The values that it may have; none: any."""
        return get_args(self.item_type) if get_origin(self.item_type) is Literal else self.option.choices

    @property
    def range(self) -> str:
        """The range in words; empty: any number."""
        low, high = self.option.low, self.option.high
        if low is not None and high is not None:
            return f"{low:g} to {high:g}"
        return f"at least {low:g}" if low is not None else f"at most {high:g}" if high is not None else ""

    def read(self, text: str) -> Any:
        """Make the value of a text, as the command line does; RequestError if it cannot."""
        if self.option.parse is not None:
            return self.option.parse((text,) if self.option.repeated else text)
        value: Any = next((each for each in self.choices if str(each) == text), text)
        if self.item_type in (int, float):
            try:
                value = self.item_type(text)
            except ValueError:
                kind = "whole number" if self.item_type is int else "number"
                raise RequestError(f"{self.names[0]} {text}: it is a {kind}.") from None
        return (value,) if self.many else value

    def word(self, value: Any) -> str:
        """Return the word of the command line that states a value: of a switch, or of a text that `read` takes."""
        return f"{self.names[0]}={value}" if not self.is_switch else self.names[0] if value else self.negative

    def accept(self, value: Any) -> Any:
        """Return the value as a request keeps it: of several or a pair a tuple, made of a list, an array or one alone.

        A text where a number belongs is read as on the command line.

        Raises RequestError if there are none, or a text is no number.
        """
        plain, single = self.plain_type, isinstance(value, str | PathLike) or not hasattr(value, "__len__")
        if isinstance(value, str) and plain in (int, float):
            return self.read(value)
        if self.holds_several:
            if value is None:
                return None
            values = (value,) if single else tuple(value)
            if self.required and not values:
                raise RequestError(f"There are no {self.field}: name at least one file.")
            return tuple(map(self._path, values))
        if set(get_args(plain)) == {float} and not single and all(isinstance(each, Real) for each in value):
            return tuple(map(float, value))
        return self._path(value)

    def _path(self, value: Any) -> Any:
        return Path(value) if isinstance(value, str) and Path in (self.plain_type, self.item_type) else value

    @property
    def python_type(self) -> Any:
        """What the field takes in Python."""
        if self.holds_several:
            (item, _) = get_args(self.plain_type)
            item = str | Path if item is Path else item
            return item | Sequence[item]  # type: ignore[valid-type]
        return self.type | str if self.plain_type is Path else self.type

    def check(self, value: Any) -> None:
        """Raise RequestError unless the value is in its range or among its choices."""
        if self.choices and value not in self.choices:
            *most, last = self.choices
            raise RequestError(f"{self.names[0]}: there is no {value!r}; choose {', '.join(most)} or {last}.")
        low, high = self.option.low, self.option.high
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, int | float) and not (
                (low is None or number >= low) and (high is None or number <= high)
            ):
                raise RequestError(f"{self.names[0]} {number:g}: it must be {self.range}.")


class Request:
    """A verb's request; its subclasses are frozen dataclasses."""

    def __post_init__(self) -> None:
        for each in declared(type(self)):
            value = each.accept(getattr(self, each.field))
            object.__setattr__(self, each.field, value)
            if not hasattr(value, "shape") and value != each.default:  # an array has no range here
                if not _fits(value, each.type):
                    raise RequestError(f"{each.field} = {_short(value)}: it must be {_plain(each.python_type)}.")
                if value is not None:
                    each.check(value)
        if not callable(progress := getattr(self, "progress", silent)):
            raise RequestError(f"progress = {_short(progress)}: it must be a function.")
        self.check()

    def check(self) -> None:
        """Raise RequestError where options do not go together."""

    def unused(self, why: str, *fields: str) -> None:
        """Raise RequestError where one of these options is given, which nothing would use."""
        for each in declared(type(self)):
            if each.field in fields and (value := getattr(self, each.field)) != each.default:
                raise RequestError(f"{each.word(value).partition('=')[0]} {why}.")


def declared(request: type[Any]) -> tuple[Declared, ...]:
    """Return the options of a request: in the order of its fields, those that may stand without a name first."""
    keyword_only = {field.name: field.kw_only for field in fields(request)}
    return tuple(sorted(_declared(request), key=lambda each: bool(keyword_only[each.field])))


def _declared(request: Any, types_: dict[str, Any] | None = None) -> Iterator[Declared]:
    hints = get_type_hints(request, localns=types_, include_extras=True)
    for field in fields(request):
        for option in getattr(hints[field.name], "__metadata__", ()):
            if isinstance(option, Option):
                yield Declared(field.name, get_args(hints[field.name])[0], field.default, option)


ABSTRACT: dict[Any, Any] = {int: Integral, float: Real, Path: (str, PathLike)}


def _fits(value: Any, hint: Any) -> bool:
    """Return whether a value is of a type, with the items of its tuples and mappings."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(_fits(value, each) for each in parts)
    if origin is Literal:
        return True  # `Declared.check` compares it with the choices
    if origin is tuple and isinstance(value, tuple | list):
        items = parts[:1] * len(value) if parts[-1] is Ellipsis else parts
        return len(value) == len(items) and all(map(_fits, value, items))
    if origin is Mapping and isinstance(value, Mapping):
        return all(_fits(key, parts[0]) and _fits(item, parts[1]) for key, item in value.items())
    return isinstance(value, origin or ABSTRACT.get(hint, hint))


def shared_with(request: Request, cls: type[Any], **others: Any) -> dict[str, Any]:
    """Return the fields of another class that a request has by the same name; what is None keeps its default there."""
    values = {each.name: getattr(request, each.name, None) for each in fields(cls)} | others
    return {name: value for name, value in values.items() if value is not None}


FORCE = Option("Overwrite files that exist.", OUTPUT)


class _Silent:
    """A progress that reports nothing; signatures show it by name."""

    def __call__(self, *progress: Any) -> None: ...

    def __repr__(self) -> str:
        return "silent"


silent = _Silent()


def function(request: Callable[P, Q], work: Callable[[Q], R]) -> Callable[P, R]:
    """Make the Python function of a verb: its parameters are the request's, its text is the worker's.

    request : class of the request
    work : takes a request, does the work
    """
    from models.machine import Machine

    machine = {"MachineLike": str | Path | Machine}
    hints, signature = get_type_hints(request, localns=machine), inspect.signature(request)
    hints |= {each.field: each.python_type for each in _declared(request, machine)}
    returned = get_type_hints(work)["return"]
    parameters = [each.replace(annotation=hints[name]) for name, each in signature.parameters.items()]
    signature = signature.replace(parameters=parameters, return_annotation=returned)
    name = work.__name__.removeprefix("_").removesuffix("_request")

    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            signature.bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{name}(): {error}") from None
        try:
            return work(request(*args, **kwargs))
        except INPUT_ERRORS as error:
            error.exit_code = explain(error)[1]  # type: ignore[union-attr]  # of files that are missing, too
            raise

    call.__name__ = call.__qualname__ = name
    call.__module__, call.__signature__ = work.__module__, signature  # type: ignore[attr-defined]
    options: Iterator[Declared] = _declared(request, machine)
    words = {each.field: f"{each.option.help} {each.range and f'[{each.range}]'}".rstrip() for each in options}
    words = {name: each.replace(" May be repeated.", "") for name, each in words.items()}
    noted = get_type_hints(request, localns=machine, include_extras=True).items()
    words |= {name: each for name, hint in noted for each in getattr(hint, "__metadata__", ()) if isinstance(each, str)}
    call.__doc__ = _docstring(inspect.cleandoc(work.__doc__ or ""), signature, words)
    return call


def _docstring(text: str, signature: inspect.Signature, words: Mapping[str, str]) -> str:
    """Complete a worker's docstring in NumPy's format: with its parameters, in these words, and what it returns."""
    summary, heading, rest = text.partition("Raises\n------")
    rows = []
    for name, parameter in signature.parameters.items():
        default = "" if parameter.default is parameter.empty else f", default {_short(parameter.default)}"
        said = re.sub(r"--no-([a-z][\w-]+)", r"--\1=False", words[name])
        said = re.sub(r"--[a-z][\w-]+", lambda match: match[0][2:].replace("-", "_"), said)
        rows += [f"{name} : {_plain(parameter.annotation)}{default}", f"    {said}"]
    returned = signature.return_annotation
    what = inspect.cleandoc(returned.__doc__ or "").partition("\n\n")[0].replace("\n", " ")
    parts = [summary.rstrip(), "", "Parameters", "----------", *rows, "", "Returns", "-------", returned.__name__]
    return "\n".join([*parts, f"    {what}", "", heading + rest])


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 60 else f"{type(value).__name__}()"


def _plain(annotation: Any) -> str:
    """Return a type as people write it."""
    name = inspect.formatannotation(annotation)
    return re.sub(r"\b(?:[a-z_]\w*\.)+(?=[A-Z])", "", name)
