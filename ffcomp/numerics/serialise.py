"""Turn results into JSON values: the one serialiser of every verb of the command line.

A dataclass becomes an object of its public fields, or of the keys that its class declares as `json_keys`. The tables of
docs/reference/json.md are made from the same declarations.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from math import isfinite
from os import PathLike, fspath
from typing import Any

ALL_OF = "…"  # the key under which the keys of another object stand in the same object
IF_ANY = "?"  # after a path: the key is left out where there is nothing


def keys(*names: str, **paths: str) -> dict[str, str]:
    """Return `json_keys`: the same names as attributes, and keys with the path of an attribute.

    A path is `plan.repeats`, or `held_out.0` of a tuple's first item; at its end `IF_ANY`. The key `gap.before` is
    `before` of the object `gap`.
    """
    return {name: name for name in names} | paths


def has_keys(cls: type) -> bool:
    """Return whether values of a class become objects."""
    return is_dataclass(cls) or hasattr(cls, "json_keys")


def keys_of(cls: type) -> Mapping[str, str]:
    """Return the JSON keys of a class, each with the path of its attribute."""
    if made := getattr(cls, "json_keys", None):
        return made
    return keys(*(each.name for each in fields(cls) if not each.name.startswith("_")))


def json_object(value: Any) -> dict[str, Any]:
    """Convert an object to that of its keys; beyond an attribute that is None everything is None."""
    made: dict[str, Any] = {}
    for key, path in keys_of(type(value)).items():
        at = value
        for name in path.removesuffix(IF_ANY).split("."):
            at = None if at is None else at[int(name)] if name.isdigit() else getattr(at, name)
        if path.endswith(IF_ANY) and (at is None or not getattr(at, "__len__", lambda: 1)()):
            continue
        *outer, last = key.split(".")
        into = made
        for name in outer:
            into = into.setdefault(name, {})
        into |= to_json(at) if key == ALL_OF else {last: to_json(at)}
    return made


def to_json(value: Any) -> Any:
    """Convert a result to values that JSON holds; TypeError if one has no counterpart there.

    Containers are converted recursively; an object with a `to_dict` becomes what that returns. NaN and infinite numbers
    become None, for JSON has neither.
    """
    if value is None or isinstance(value, str | bool | int):
        return value.value if isinstance(value, Enum) else value
    if isinstance(value, float):
        return float(value) if isfinite(value) else None
    if isinstance(value, Enum):
        return to_json(value.value)
    if hasattr(value, "to_dict"):
        return to_json(value.to_dict())
    if has_keys(type(value)):
        return json_object(value)
    if isinstance(value, Mapping):
        return {key if isinstance(key, str) else str(to_json(key)): to_json(each) for key, each in value.items()}
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy, which is not imported for this
        return to_json(value.tolist())
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, Iterable) and not isinstance(value, bytes | bytearray):
        return [to_json(each) for each in value]
    raise TypeError(f"A value of the type {type(value).__name__} cannot be written as JSON.")


def json_line(value: Any) -> str:
    """Write a result as one line of JSON."""
    return json.dumps(to_json(value), ensure_ascii=False, allow_nan=False)
