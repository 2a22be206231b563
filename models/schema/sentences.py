"""Mistakes that pydantic finds, as sentences in a machine file's own words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from models.schema.table import Table, number_keys, table_of
from models.schema.words import did_you_mean, unit_of

RULES = {  # pydantic's type of error -> our rule, filled in from its context
    "greater_than_equal": "must be at least {ge:g}{unit}",
    "less_than_equal": "must be at most {le:g}{unit}",
    "greater_than": "must be greater than {gt:g}{unit}",
    "less_than": "must be less than {lt:g}{unit}",
    "float_type": "must be a number{unit}",
    "finite_number": "must be a finite number{unit}",
    "string_type": "must be a text in quotes",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must be a name: a letter or _ first, then letters, digits and _",
    "list_type": "must be a list of {count} numbers{unit}",
    "too_short": "must be a list of {count} numbers{unit}",
    "too_long": "must be a list of {count} numbers{unit}",
    "dict_type": "must be a table",
    "model_type": "must be a table",
}


PAIRS = ("limits.carriage_travel_mm", *(f"kinematics.{axis}_range_mm" for axis in "xyz"))  # lists of two numbers


def sentences(error: Mapping[str, Any], kind: type[Table]) -> list[str]:
    """One of pydantic's errors in our words (a validator of ours may have found several mistakes)."""
    context = {**error.get("ctx", {}), "document": kind}
    if error["type"] == "value_error":
        return str(context["error"]).split("\n")
    write = SENTENCES.get(error["type"], _broken_rule)
    return [write(error["loc"], error["input"], error["type"], context)]


def _missing(loc: tuple[int | str, ...], value: object, kind: str, context: Mapping[str, Any]) -> str:
    return f"{_key(loc)} is missing."


def _unknown_key(loc: tuple[int | str, ...], value: object, kind: str, context: Mapping[str, Any]) -> str:
    return f"{_key(loc)} is not a key of a machine file.{_right_key(loc, context['document'])}"


def _wrong_word(loc: tuple[int | str, ...], value: object, kind: str, context: Mapping[str, Any]) -> str:
    expected = context["expected"]
    return f"{_key(loc)} = {value!r} must be {expected}.{did_you_mean(str(value), expected.split(chr(39)))}"


def _broken_rule(loc: tuple[int | str, ...], value: object, kind: str, context: Mapping[str, Any]) -> str:
    unit = unit_of(_key(loc).split("[")[0])
    count = "two" if _key(loc) in PAIRS else "one to eight" if _key(loc).startswith("axes.") else "three"
    rule = RULES[kind].format(**context, count=count, unit=f" ({unit})" if unit else "")
    return f"{_key(loc)} = {'{…}' if isinstance(value, dict) else repr(value)} {rule}."


SENTENCES: dict[str, Callable[..., str]] = {
    "missing": _missing,
    "extra_forbidden": _unknown_key,
    "literal_error": _wrong_word,
}


def _key(loc: tuple[int | str, ...]) -> str:
    """`table.key`, or `table.key[index]` of a list."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc).lstrip(".")


def _right_key(loc: tuple[int | str, ...], document: type[Table]) -> str:
    """Suggest for an unknown key the same key in another table, or the nearest one in its own."""
    word = str(loc[-1])
    elsewhere = [key for key in number_keys(document) if key.endswith(f".{word}")]
    if elsewhere:
        return f" Did you mean {elsewhere[0]!r}?"
    table = document
    for part in loc[:-1]:
        table = table_of(table.model_fields[str(part)].annotation) or table
    return did_you_mean(word, table.model_fields)
