"""The base of every table of a machine file: units, ranges, no unknown keys, and mistakes as sentences.

The ranges admit any printer and catch most numbers in a wrong unit. pydantic finds the mistakes.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from models.quantities import PLAIN


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """' Did you mean …?' or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" Did you mean {close[0]!r}?" if close else ""


Length = Annotated[float, Field(ge=10, le=2000)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Offset = Annotated[float, Field(ge=-500, le=500)]
Place = Annotated[float, Field(ge=-1000, le=10000)]
Stiffness = Annotated[float, Field(ge=1, le=1e9)]
Damping = Annotated[float, Field(ge=0, le=1e5)]
TWO, THREE, FOUR = (Field(min_length=n, max_length=n) for n in (2, 3, 4))
MODES = Field(min_length=1, max_length=8)


class Table(BaseModel):
    """Base of every table: no unknown keys, no conversions."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True, defer_build=True)

    def record(self, **dump: Any) -> dict[str, Any]:
        """Return the values with tuples for lists; `dump` as for `model_dump`."""
        return {key: tuple(x) if isinstance(x, list) else x for key, x in self.model_dump(**dump).items()}


def table_of(annotation: Any) -> type[Table] | None:
    """Return the table behind `X` or `X | None`."""
    for candidate in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, Table):
            return candidate
    return None


def number_keys(table: type[BaseModel]) -> Iterator[str]:
    """Every number a machine file may hold, as `table.key`."""
    for name, field in table.model_fields.items():
        inner = table_of(field.annotation)
        if inner is not None:
            yield from (f"{name}.{key}" for key in number_keys(inner))
        elif PLAIN.unit_of(name) or name == "damping_ratio":
            yield name


def refuse(problems: Iterable[str]) -> None:
    """Raise through pydantic, which passes the text on to `sentences`."""
    text = "\n".join(problems)
    if text:
        raise ValueError(text)


RULES = {  # pydantic's type of error -> our rule, filled in from its context
    "greater_than_equal": "must be at least {ge:g}{unit}",
    "less_than_equal": "must be at most {le:g}{unit}",
    "greater_than": "must be greater than {gt:g}{unit}",
    "less_than": "must be less than {lt:g}{unit}",
    "float_type": "must be a number{unit}",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
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
    """Return one of pydantic's errors in our words; a validator of ours may report several mistakes."""
    if error["type"] == "value_error":
        return str(error["ctx"]["error"]).split("\n")
    return [_sentence(error["type"], error["loc"], error["input"], error.get("ctx", {}), kind)]


def _sentence(
    rule: str, loc: tuple[int | str, ...], value: object, context: Mapping[str, Any], document: type[Table]
) -> str:
    key = _key(loc)
    if rule == "missing":
        return f"{key} is missing."
    if rule == "extra_forbidden":
        return f"{key} is not a key of a machine file.{_right_key(loc, document)}"
    if rule == "literal_error":
        expected = context["expected"]
        return f"{key} = {value!r} must be {expected}.{did_you_mean(str(value), expected.split(chr(39)))}"
    unit = PLAIN.unit_of(key.split("[")[0])
    count = "two" if key in PAIRS else "one to eight" if key.startswith("axes.") else "three"
    text = RULES[rule].format(**context, count=count, unit=f" ({unit})" if unit else "")
    return f"{key} = {'{…}' if isinstance(value, dict) else repr(value)} {text}."


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
