"""docs/reference/json.md: keys and types come from the classes of the results; what a key means is written by hand.

A table is made where the class of its object is known: a result by its `schema`, others by `SHARED`. A new key gets a
row that waits for its meaning.
"""

from __future__ import annotations

import re
import sys
import textwrap
import types
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import reduce
from importlib import import_module
from inspect import get_annotations, getsource
from operator import or_
from pathlib import Path
from typing import Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from ffcomp.comparison.result import EqualQuality, Error, Method
from ffcomp.compensation.result import Failure
from ffcomp.diagnosis.result import Interval, Nearest, PartlyExplained
from ffcomp.diagnosis.where import ResidualSize
from ffcomp.estimation.statistics import Spent, Statistics
from ffcomp.identification.uncertainty import Estimate
from ffcomp.metrics import Track
from ffcomp.numerics.serialise import ALL_OF, IF_ANY, has_keys, keys_of
from ffcomp.record.plan import Plan
from ffcomp.responses.result import Bode
from ffcomp.result import Answer, Result
from ffcomp.simulation.expectation import Expectation
from models import quantities
from models.checks import Extreme
from models.machine import Machine

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "json.md"
SHARED: dict[type, str] = {
    Track: "TRACK",
    Expectation: "EXPECTATION",
    Answer: "ANSWER",
    Machine: "MACHINE",
    Estimate: "ESTIMATE",
    Error: "ERROR",
    ResidualSize: "SIZE",
    Extreme: "EXTREME",
    Method: "METHOD",
    Statistics: "ACCOUNT",
    Spent: "SPENT",
    EqualQuality: "QUALITY",
    Bode: "BODE",
    Interval: "INTERVAL",
    Nearest: "REFUSED",
    PartlyExplained: "DOMINANT",
    Plan: "ffcomp-moves/1",
    Failure: "FAILED",
}
MISSING = ", may be missing"
PLAIN = {type(None): "null", str: "text", Path: "text", float: "number", int: "whole number", bool: "true or false"}
_TABLE = re.compile(r"^##+ (ffcomp-[\w-]+/\d+|[A-Z]+)\n(?:(?!^##|^\|).*\n)*\|.*\n\|.*\n((?:\|.*\n)+)", re.MULTILINE)


def page() -> str:
    """Return the page, with the tables as the classes have them."""
    known = classes()
    return _TABLE.sub(lambda match: _filled(match, known.get(match[1], ())), PAGE.read_text(encoding="utf-8"))


def classes() -> dict[str, list[type]]:
    """Return the classes of each object, by its name on the page: a result of several kinds has several."""
    for path in (ROOT / "ffcomp").rglob("*.py"):
        if "json_keys" in path.read_text(encoding="utf-8"):
            import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    found, results = {name: [cls] for cls, name in SHARED.items()}, [Result]
    for each in results:
        results += each.__subclasses__()
        if each.schema and not each.__subclasses__():
            found.setdefault(each.schema, []).append(each)
    return found


def _filled(match: re.Match[str], classes: Sequence[type]) -> str:
    if not classes:
        return match[0]
    by_hand = {key: rest for _, key, *rest in (re.split(r" *(?<!\\)\| *", line) for line in match[2].splitlines())}
    own, text = rows_of_all(classes), ""
    first = [("schema", "text")] if match[1].startswith("ffcomp-") else []
    last = [("answer", "ANSWER")] if issubclass(classes[0], Result) else []
    for key, kind in (*first, *own, *last):
        of_key = quantities.PLAIN.unit_of(key.rpartition(".")[2].removesuffix("[]"))
        was, unit, meaning, *_ = by_hand.get(f"`{key}`", (kind, of_key, ""))
        text += f"| `{key}` | {kind or was} | {unit} | {meaning} |\n".replace("|  |\n", "| |\n")
    return match[0].removesuffix(match[2]) + text


def rows_of_all(classes: Sequence[type]) -> list[tuple[str, str]]:
    """Return the rows of classes that share an object; a key that not all of them have may be missing."""
    each = [dict(rows_of(cls)) for cls in classes]
    every = {key: kind for of in each for key, kind in of.items()}
    inside = re.compile(r"[.\[]")
    return [
        (key, kind if MISSING in kind or inside.search(key) or all(key in of for of in each) else f"{kind}{MISSING}")
        for key, kind in every.items()
    ]


def rows_of(cls: type, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the keys of an object, and of those in it that have no table of their own, with their types."""
    for key, path in keys_of(cls).items():
        kind, optional = cls, False
        for name in path.removesuffix(IF_ANY).split("."):
            kind, may_be_none = without_none(type_of(kind, name))
            optional |= may_be_none
        null = MISSING if path.endswith(IF_ANY) else " or null" * optional
        if key == ALL_OF and kind not in SHARED:
            yield from rows_of(kind, prefix)
        else:
            yield from rows(f"{prefix}{key}", kind, null)


def rows(key: str, kind: Any, null: str = "") -> Iterator[tuple[str, str]]:
    """Yield the rows of one key: one, or those of the objects that it holds."""
    kind, may_be_none = without_none(kind)
    null, (inside, mark) = null or " or null" * may_be_none, items_of(kind)
    if name := name_of(kind):
        yield key, f"{name}{null}"
    elif isinstance(kind, type) and has_keys(kind):
        yield from rows_of(kind, f"{key}.")
    elif mark == ".*" or holds_objects(inside):
        yield from rows(f"{key}{mark}", inside)
    else:
        by_hand = kind is Any or (get_origin(kind) is np.ndarray and not null)  # a type names no shape
        yield key, "" if by_hand else f"{words(kind)}{null}"


def name_of(kind: Any) -> str:
    """Return the name of the object that a type, or each of a union, becomes; empty: one has none."""
    either = get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)
    named = [SHARED.get(each) or getattr(each, "schema", "") for each in either]
    return " or ".join(named) if all(named) else ""


def holds_objects(kind: Any) -> bool:
    """Whether a list's items are objects, or lists of them."""
    inside, _ = items_of(kind)
    is_one = bool(name_of(kind)) or (isinstance(kind, type) and has_keys(kind))
    return is_one or (inside is not None and holds_objects(inside))


def items_of(kind: Any) -> tuple[Any, str]:
    """Return the type of the items of a list or of a mapping, and its mark in a key; None: it is neither."""
    origin, of = get_origin(kind), get_args(kind)
    if not isinstance(origin, type) or not of or issubclass(origin, np.ndarray):
        return None, ""
    if issubclass(origin, Mapping):
        return of[1], ".*"
    return (of[0], "[]") if issubclass(origin, Collection) else (None, "")


def words(kind: Any) -> str:
    """Return a type as the page names it."""
    inside, _ = items_of(kind)
    if get_origin(kind) is tuple and len(set(get_args(kind)) - {Ellipsis}) > 1:
        return "list"
    if inside is not None:
        return "list of " + re.sub(r"(number|list|null)(?!s)", r"\1s", words(inside).replace(" or ", " and "))
    if get_origin(kind) is np.ndarray:
        return "list of numbers"
    if get_origin(kind) in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(words, get_args(kind))))
    return "text" if get_origin(kind) is Literal else PLAIN[kind]


def without_none(kind: Any) -> tuple[Any, bool]:
    """Return a type without None, and whether it had it."""
    if get_origin(kind) not in (Union, types.UnionType) or type(None) not in get_args(kind):
        return kind, False
    return reduce(or_, (each for each in get_args(kind) if each is not type(None))), True


def type_of(cls: type, name: str) -> Any:
    """Return the type of an attribute: a field or a property; of a tuple's item."""
    if name.isdigit():
        return get_args(cls)[int(name)]
    for owner in cls.__mro__:
        value = vars(owner).get(name)
        if getter := getattr(value, "fget", getattr(value, "func", None)):  # of a property, or of a cached one
            return get_type_hints(getter, localns=_names(owner))["return"]
        if name in get_annotations(owner):
            kind = get_type_hints(owner, localns=_names(owner))[name]
            return get_args(kind)[0] if get_origin(kind) is ClassVar else kind
    raise ValueError(f"{cls.__name__} has no attribute {name!r} of a stated type.")


def _names(owner: type) -> dict[str, Any]:
    """Return the names of a class's module, those under `if TYPE_CHECKING` included."""
    module = sys.modules[owner.__module__]
    names = dict(vars(module))
    for block in re.findall(r"^if TYPE_CHECKING:\n((?:    .*\n|\n)+)", getsource(module), re.MULTILINE):
        exec(textwrap.dedent(block), names)
    return names
