"""The tables of the report, as text: effects, hypotheses, candidates, places, retuned numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.fit import intervals_of
from ffcomp.diagnosis.held_out import HeldOut
from ffcomp.diagnosis.result import DiagnosisResult, of_machine
from ffcomp.diagnosis.score_test import separated_by
from ffcomp.diagnosis.words import (
    INFINITELY,
    digits,
    evidence,
    interval,
    joined,
    percent,
    times,
    times_noise,
    title,
)
from ffcomp.identification.uncertainty import Estimate
from ffcomp.report.diagnose.summary import Confounding
from ffcomp.report.drawing import AFTER, BEFORE, SOFT
from models.effects.effect import Effect, Parameter
from models.quantities import Quantities

Catalogue = Mapping[str, Effect]

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


def evidence_rows(diagnosis: Diagnosis, catalogue: Catalogue) -> list[EvidenceRow]:
    """Return the hypotheses that were tried, and retuning alone; the likeliest first."""
    if diagnosis.best is None:
        return []
    base, named = diagnosis.base, () if diagnosis.named is None else diagnosis.named.names
    tried = [(h.names, h.fit, diagnosis.behind(h)) for h in diagnosis.tried]
    tried.append(((), base, base.evidence - diagnosis.best.fit.evidence))
    return [
        EvidenceRow(
            " + ".join(names) if names else "nothing added, only retuned",
            "; ".join(title(name, catalogue) for name in names),
            digits(times_noise(fit.discrepancy)),
            evidence(behind),
            len(fit.parameters),
            bool(names) and names == named,
        )
        for names, fit, behind in sorted(tried, key=lambda each: each[2])
    ]


@dataclass(frozen=True, slots=True)
class PromiseRow:
    """One effect in the score test."""

    name: str
    title: str
    gain: str
    strength: str
    visible: bool


def promise_rows(diagnosis: Diagnosis, catalogue: Catalogue) -> list[PromiseRow]:
    """Return the effects in the score test, visible ones first."""
    return [
        PromiseRow(
            s.candidate.name,
            title(s.candidate.name, catalogue),
            evidence(-s.evidence),
            digits(s.strength, 2) if s.strength < 100 else evidence(s.strength),
            s.visible,
        )
        for s in sorted(diagnosis.screened, key=lambda s: (not s.visible, s.evidence))
    ]


@dataclass(frozen=True, slots=True)
class RetunedRow:
    """One retuned parameter."""

    name: str
    start: str
    now: str
    allowed: str  # relative standard deviation; absolute, where the file says zero
    moved: bool
    sds: str


def retuned_rows(diagnosis: Diagnosis, quantities: Quantities) -> list[RetunedRow]:
    """Return every parameter of the machine file, those that moved furthest first."""
    full = diagnosis.base if diagnosis.best is None else diagnosis.best.fit
    values = diagnosis.final.values
    intervals = diagnosis.intervals or intervals_of(diagnosis.estimation, full, values)
    moved = [(n, (intervals[n.name].value - n.start) / n.sd) for n in full.parameters if of_machine(n.name)]
    return [
        RetunedRow(
            quantities.key(n.name),
            digits(n.start, 5),
            interval(intervals[n.name]),
            percent(n.sd / abs(n.start)) if n.start else digits(n.sd),
            values.get(n.name, n.start) != n.start,
            f"{sds:+.1f}",
        )
        for n, sds in sorted(moved, key=lambda each: -abs(each[1]))
    ]


@dataclass(frozen=True, slots=True)
class PlaceRow:
    """One position left out of the fit."""

    label: str
    before: str  # error, times the noise
    after: str
    left: str  # of the excess


def place_rows(places: Sequence[HeldOut], labels: Sequence[str]) -> list[PlaceRow]:
    """Return the positions left out of the fit."""
    rows = []
    for label, p in zip(labels, places, strict=True):
        share = max(p.after, 0.0) / p.before if p.before > 0 else np.nan
        left = "–" if np.isnan(share) else percent(share) if share >= 1e-3 else "< 0.1 %"
        rows.append(PlaceRow(label, digits(times_noise(p.before)), digits(times_noise(p.after)), left))
    return rows


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


def confounded_rows(result: DiagnosisResult, alike: Confounding) -> list[Confounded]:
    """List for each effect of the best hypothesis the visible ones most like it."""
    named, catalogue, rows = tuple(result.effects), result.names.catalogue, list[Confounded]()
    for name in named:
        if name not in alike.names:
            continue
        row = alike.cos2[alike.names.index(name)]
        others = [(alike.names[i], float(row[i])) for i in np.argsort(-row) if alike.names[i] not in named]
        for other, cos2 in others[:MOST_CONFOUNDED]:
            if cos2 > SHOWN_COS2:
                apart = separated_by([name], [other], catalogue)
                rows.append(Confounded(name, other, title(other, catalogue), f"{cos2:.2f}", apart))
    return rows
