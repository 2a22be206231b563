"""The tables of the report, as text: effects, hypotheses, candidates, places, retuned numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffcomp.diagnosis.acceptance import HeldOut
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.summary import DiagnosisSummary
from ffcomp.identification.uncertainty import Estimate
from ffcomp.report.diagnose.words import (
    INFINITELY,
    digits,
    evidence,
    interval,
    joined,
    percent,
    times,
    times_noise,
    title,
    together,
)
from ffcomp.report.drawing import AFTER, BEFORE, SOFT
from models.effects.effect import Effect, Parameter

OF_THREE = {"per_tower": "ABC", "vector3": "xyz"}
SHOWN_COS2 = 0.3
MOST_CONFOUNDED = 5


@dataclass(frozen=True, slots=True)
class Tile:
    """One of the big numbers on top."""

    label: str
    number: str
    below: str
    colour: str
    share: float  # of the largest, %


def tiles(result: DiagnosisResult) -> list[Tile]:
    """Return the error of the simulation before and after, and that of noise alone."""
    names = " + ".join(result.effects)
    after = {
        "effects": f"with {names}",
        "none": "retuned",
        "unknown": f"with {names or 'retuning'}{'' if result.named else ', refused'}",
    }
    before, noise = result.gap.before.nrms, result.gap.noise
    most = max(before, result.gap.after.nrms, noise, 1e-12)
    sizes = [
        ("as the file is", before, f"{times(before / noise)} the noise", BEFORE),
        (after[result.verdict], result.gap.after.nrms, f"{times(result.gap.after.nrms / noise)} the noise", AFTER),
        ("noise alone", noise, "as two runs of one experiment differ", SOFT),
    ]
    return [Tile(label, percent(x), below, colour, 100 * x / most) for label, x, below, colour in sizes]


@dataclass(frozen=True, slots=True)
class EvidenceRow:
    """One hypothesis."""

    effects: str
    titles: str
    left: str  # error, times the noise
    behind: str  # in −2 ln Z
    numbers: int
    named: bool


def evidence_rows(summary: DiagnosisSummary) -> list[EvidenceRow]:
    """Return the hypotheses, the likeliest first."""
    return [
        EvidenceRow(
            together(e.effects),
            "; ".join(title(name, summary.catalogue) for name in e.effects),
            digits(times_noise(e.left)),
            evidence(e.against_best),
            e.parameters,
            e.named,
        )
        for e in sorted(summary.evidence, key=lambda e: e.against_best)
    ]


@dataclass(frozen=True, slots=True)
class PromiseRow:
    """One effect in the score test."""

    name: str
    title: str
    gain: str
    strength: str
    visible: bool


def promise_rows(summary: DiagnosisSummary) -> list[PromiseRow]:
    """Return the effects in the score test, visible ones first."""
    return [
        PromiseRow(
            p.name,
            title(p.name, summary.catalogue),
            evidence(p.gain),
            _sigmas(p.strength),
            p.visible,
        )
        for p in sorted(summary.promises, key=lambda p: (not p.visible, -p.gain))
    ]


def _sigmas(strength: float) -> str:
    return digits(strength, 2) if strength < 100 else evidence(strength)


@dataclass(frozen=True, slots=True)
class RetunedRow:
    """One retuned parameter."""

    name: str
    start: str
    now: str
    allowed: str  # relative standard deviation; absolute, where the file says zero
    moved: bool
    sds: str


def retuned_rows(summary: DiagnosisSummary) -> list[RetunedRow]:
    """Return the retuned parameters."""
    return [
        RetunedRow(
            r.name,
            digits(r.start, 5),
            interval(r.now),
            percent(r.sd / abs(r.start)) if r.start else digits(r.sd),
            r.moved,
            f"{(r.now.value - r.start) / r.sd:+.1f}",
        )
        for r in summary.retuned
    ]


@dataclass(frozen=True, slots=True)
class PlaceRow:
    """One position left out of the fit."""

    label: str
    before: str  # error, times the noise
    after: str
    left: str  # of the excess


def place_rows(summary: DiagnosisSummary, labels: list[str]) -> list[PlaceRow]:
    """Return the positions left out of the fit."""
    return [
        PlaceRow(
            label,
            digits(times_noise(p.before)),
            digits(times_noise(p.after)),
            _left(p),
        )
        for label, p in zip(labels, summary.held_out, strict=True)
    ]


def _left(p: HeldOut) -> str:
    if p.before <= 0:
        return "–"
    share = max(p.after, 0.0) / p.before
    return percent(share) if share >= 1e-3 else "< 0.1 %"


# ---- effects -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class EffectRow:
    """One number of an effect."""

    key: str
    value: str
    interval: str  # 90 %
    usual: str
    meaning: str


def effect_rows(result: DiagnosisResult, effect: str) -> list[EffectRow]:
    """Every number, in the order of the catalogue."""
    intervals = _of(result, effect)
    return [
        _row(parameter, name, estimate, result.effects[effect])
        for parameter in result.names.catalogue[effect].by_name.values()
        for name, estimate in intervals.items()
        if name.partition("[")[0] == parameter.name
    ]


def _of(result: DiagnosisResult, effect: str) -> dict[str, Estimate]:
    """Return the estimates of an effect by its keys in the machine's file, and in its units."""
    prefix, quantities = f"effects.{effect}.", result.names.quantities
    return {
        quantities.key(name.removeprefix(prefix)): e.scaled(quantities.scale(name))
        for name, e in result.intervals.items()
        if name.startswith(prefix)
    }


def _row(p: Parameter, name: str, e: Estimate, table: Mapping[str, Any]) -> EffectRow:
    low, high = p.typical
    usual = f"{low:g} to {high:g}{f' {p.unit}' if p.unit else ''}"
    if p.size == "direction":
        return EffectRow(name, _direction(table[p.name]), "", "", p.meaning)
    if e.value >= INFINITELY:
        return EffectRow(name, "no effect", "", usual, p.meaning)
    value, _, range_90 = interval(e, p.unit).partition(" (90 %: ")
    which = OF_THREE.get(p.size) if "[" in name else None
    meaning = f"{p.meaning}, {which[int(name[-2])]}" if which else p.meaning
    return EffectRow(name, value, range_90.rstrip(")"), usual, meaning)


def _direction(value: Any) -> str:
    if isinstance(value, str):
        return "x and y alike" if value == "both" else value
    return f"{math.degrees(math.atan2(value[1], value[0])):.0f}° from x"


def in_words(result: DiagnosisResult, effect: str) -> str:
    """`more on the nozzle holder (effector_mass): added_kg 0.0801 kg (90 %: 0.0795 to 0.0807)`."""
    amplitudes = [_amplitude(result, effect, p) for p in result.names.catalogue[effect].amplitudes]
    numbers = joined([words for words in amplitudes if words])
    return f"{title(effect, result.names.catalogue)} ({effect}){f': {numbers}' if numbers else ''}"


def _amplitude(result: DiagnosisResult, effect: str, p: Parameter) -> str:
    values = [e for name, e in _of(result, effect).items() if name.partition("[")[0] == p.name]
    if len(values) == 1:
        return interval(values[0], p.unit)
    if not values:
        return ""
    names = OF_THREE.get(p.size, tuple(str(i + 1) for i in range(len(values))))
    each = joined([f"{name} {digits(e.value)}" for name, e in zip(names, values, strict=True)])
    return f"{each}{f' {p.unit}' if p.unit else ''} ({p.meaning})"


# ---- confounded effects --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Confounded:
    """One pair of confounded effects."""

    effect: str
    other: str
    title: str
    cos2: str
    apart: str  # how to tell them apart; '' if the catalogue does not say


def confounded_rows(result: DiagnosisResult, summary: DiagnosisSummary) -> list[Confounded]:
    """List for each effect of the best hypothesis the visible ones most like it."""
    alike, named, rows = summary.confounding, tuple(result.effects), list[Confounded]()
    for name in named:
        if name not in alike.names:
            continue
        row = alike.cos2[alike.names.index(name)]
        others = [(alike.names[i], float(row[i])) for i in np.argsort(-row) if alike.names[i] not in named]
        rows += [
            _confounded(name, other, c, result.names.catalogue)
            for other, c in others[:MOST_CONFOUNDED]
            if c > SHOWN_COS2
        ]
    return rows


def _confounded(name: str, other: str, cos2: float, catalogue: Mapping[str, Effect]) -> Confounded:
    apart = catalogue[name].confounded_with.get(other) or catalogue[other].confounded_with.get(name) or ""
    return Confounded(name, other, title(other, catalogue), f"{cos2:.2f}", apart)
