"""What every table of a machine file has: no unknown keys, no conversions; and the ranges of its numbers.

The ranges hold any printer, and catch most numbers in a wrong unit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from models.schema.words import unit_of

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

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


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
        elif unit_of(name) or name == "damping_ratio":
            yield name


def refuse(problems: Iterable[str]) -> None:
    """Tell pydantic, which carries the text to `sentences`."""
    text = "\n".join(problems)
    if text:
        raise ValueError(text)
