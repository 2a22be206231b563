"""Rules of `[effects]`: effects of the catalogue, their parameters, and forces per kilogram."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from models.effects.catalogue import CATALOGUE, effects_of
from models.effects.effect import PER_KILOGRAM
from models.schema.table import refuse
from models.schema.words import did_you_mean


def refuse_others(effects: Mapping[str, Mapping[str, Any]], moves: str, kind: str) -> None:
    """Refuse effects, and keys of effects, that this kind of machine cannot have."""
    able = effects_of(moves)
    refuse(
        f"effects.{name} is none of {kind}. Known there: {', '.join(able)}."
        for name in effects
        if name in CATALOGUE and name not in able
    )
    refuse(
        f"effects.{name}.{key.name} is of one axis by itself: it tells which of two springs is meant."
        for name, table in effects.items()
        if name in able and moves != "axis"
        for key in CATALOGUE[name].of_axis
        if key.name in table
    )
    refuse(
        f"effects.{name}.{key.name} is of printers: on one axis by itself friction that bends is bristle_friction."
        for name, table in effects.items()
        if name in able and moves == "axis"
        for key in CATALOGUE[name].of_printers
        if key.name in table
    )


def mass_problems(name: str, table: Any, weighed: bool) -> Iterator[str]:
    """Yield what is wrong with the keys of forces of an effect on axes whose mass is stated, or is not."""
    if name not in CATALOGUE or not isinstance(table, dict):
        return
    for key in table:
        plain = key.removesuffix(PER_KILOGRAM)
        if plain not in CATALOGUE[name].by_name or not CATALOGUE[name].parameter(plain).of_mass:
            continue
        if weighed and plain != key:
            yield f"effects.{name}.{key}: the axes state their mass_kg, so this is {plain}."
        elif not weighed and plain == key:
            yield (
                f"effects.{name}.{key}: no axis states its mass. State axes.x.mass_kg and axes.y.mass_kg, "
                f"or give {key}{PER_KILOGRAM}, per kilogram of what the axis moves."
            )


def plain_keys(table: Any) -> Any:
    """Return an effect's table with its keys as they are where masses are stated."""
    if not isinstance(table, dict):
        return table
    return {key.removesuffix(PER_KILOGRAM): value for key, value in table.items()}


def effect_problems(name: str, table: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is wrong with the table of an effect."""
    if name not in CATALOGUE:
        yield f"effects.{name} is not an effect ffcomp knows.{did_you_mean(name, CATALOGUE)}"
        return
    effect = CATALOGUE[name]
    for key, value in table.items():
        if key not in effect.by_name:
            yield f"effects.{name}.{key} is not a parameter of this effect.{did_you_mean(key, effect.by_name)}"
        elif rule := effect.parameter(key).problem(value):
            yield f"effects.{name}.{key} = {value!r} {rule}."
    for key in effect.missing(table):
        yield f"effects.{name}.{key} is missing; {effect.parameter(key).meaning}."


def effect_keys() -> Iterator[str]:
    """Every parameter of every effect, as a machine file's `[uncertainty]` names it."""
    for name, effect in CATALOGUE.items():
        yield from (f"effects.{name}.{parameter}" for parameter in effect.by_name)
