"""Turn results into JSON values: the one serialiser of every verb of the command line."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from math import isfinite
from os import PathLike, fspath
from typing import Any


def to_json(value: Any) -> Any:
    """Convert a result to values that JSON holds.

    Parameters
    ----------
    value : dataclass, mapping, array, path, enumeration member or plain value
        Containers are converted recursively; a dataclass becomes an object of its public fields.

    Returns
    -------
    dict, list, str, int, float, bool or None
        NaN and infinite numbers become None, for JSON has neither.

    Raises
    ------
    TypeError
        If a value has no counterpart in JSON.
    """
    if value is None or isinstance(value, str | bool | int):
        return value.value if isinstance(value, Enum) else value
    if isinstance(value, float):
        return float(value) if isfinite(value) else None
    if isinstance(value, Enum):
        return to_json(value.value)
    if is_dataclass(value) and not isinstance(value, type):
        names = (each.name for each in fields(value) if not each.name.startswith("_"))
        return {name: to_json(getattr(value, name)) for name in names}
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
