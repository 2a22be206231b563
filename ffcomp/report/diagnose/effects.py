"""The effects of a diagnosis in words: what each is, how large, what it usually is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.identify.uncertainty import Estimate
from ffcomp.report.diagnose.words import INFINITELY, digits, interval, joined, title
from models.effects.catalogue import CATALOGUE
from models.effects.effect import Parameter

OF_THREE = {"per_tower": "ABC", "vector3": "xyz"}


@dataclass(frozen=True)
class Row:
    """One number of an effect."""

    key: str
    value: str
    interval: str  # 90 %
    usual: str
    meaning: str


def rows(found: DiagnosisResult, effect: str) -> list[Row]:
    """Every number that was found, in the order of the catalogue."""
    intervals = _of(found.intervals, effect)
    return [
        _row(parameter, name, estimate, found.effects[effect])
        for parameter in CATALOGUE[effect].by_name.values()
        for name, estimate in intervals.items()
        if name.partition("[")[0] == parameter.name
    ]


def _of(intervals: Mapping[str, Estimate], effect: str) -> dict[str, Estimate]:
    prefix = f"effects.{effect}."
    return {name.removeprefix(prefix): e for name, e in intervals.items() if name.startswith(prefix)}


def _row(p: Parameter, name: str, e: Estimate, table: Mapping[str, Any]) -> Row:
    low, high = p.typical
    usual = f"{low:g} to {high:g}{f' {p.unit}' if p.unit else ''}"
    if p.size == "direction":
        return Row(name, _direction(table[p.name]), "", "", p.meaning)
    if e.value >= INFINITELY:
        return Row(name, "no effect", "", usual, p.meaning)
    value, _, range_90 = interval(e, p.unit).partition(" (90 %: ")
    meaning = f"{p.meaning}, {OF_THREE[p.size][int(name[-2])]}" if "[" in name else p.meaning
    return Row(name, value, range_90.rstrip(")"), usual, meaning)


def _direction(value: Any) -> str:
    if isinstance(value, str):
        return "x and y alike" if value == "both" else value
    return f"{math.degrees(math.atan2(value[1], value[0])):.0f}° from x"


def in_words(found: DiagnosisResult, effect: str) -> str:
    """`more on the nozzle holder (effector_mass): added_kg 0.0801 kg (90 %: 0.0795 to 0.0807)`."""
    given = [_amplitude(found, effect, p) for p in CATALOGUE[effect].amplitudes]
    numbers = joined([words for words in given if words])
    return f"{title(effect)} ({effect}){f': {numbers}' if numbers else ''}"


def _amplitude(found: DiagnosisResult, effect: str, p: Parameter) -> str:
    own = [e for name, e in _of(found.intervals, effect).items() if name.partition("[")[0] == p.name]
    if len(own) == 1:
        return interval(own[0], p.unit)
    if not own:
        return ""
    values = joined([f"{axis} {digits(e.value)}" for axis, e in zip(OF_THREE[p.size], own, strict=True)])
    return f"{values}{f' {p.unit}' if p.unit else ''} ({p.meaning})"
