"""Verdicts against labels: rates with Wilson's intervals against aims, the confusion matrix, the numbers' errors.

A verdict is the JSON of `ffcomp diagnose --json`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from validation.blind.cases import Label
from validation.blind.kinds import KINDS

FAILED = "failed"  # a verdict that is none: the tool ended with an error
# numbers whose meaning needs the machine file's own shape of the effect: the printer has another
INEXACT = {
    "torque_angle": ("amplitude_mm",),
    "belt_hardening": ("cubic_n_per_m3",),
    "stribeck_friction": ("extra_force_n", "velocity_mm_per_s"),
    "belt_position_stiffness": ("q_centre_mm",),
    "sensor_lag": ("damping_ratio",),
}
# laws of one family: a residual can hide how they differ
FAMILIES = (frozenset({"coulomb_friction", "bristle_friction"}),)  # dry friction, whatever it does before it slides


@dataclass(frozen=True)
class Judged:
    """A case with its answer."""

    name: str
    label: Label
    verdict: Mapping[str, Any]

    @property
    def named(self) -> frozenset[str]:
        """Return the names of a verdict, without those that are true as well and need not be named."""
        names = {effect["name"] for effect in self.verdict.get("effects", []) if self.verdict["verdict"] == "effects"}
        return frozenset(names - set(self.label.also))

    @property
    def says(self) -> str:
        """Return the verdict; `none` if it names only what need not be named."""
        verdict = str(self.verdict["verdict"])
        return "none" if verdict == "effects" and not self.named else verdict

    @property
    def dominant(self) -> str:
        """Return the effect that a verdict names with a rest, '' if none."""
        return str((self.verdict.get("dominant") or {}).get("name", ""))

    @property
    def right_with_rest(self) -> bool:
        """Right, or the one effect that is hidden is named with a rest."""
        return self.right or {self.dominant} == self.truth

    @property
    def right_by_family(self) -> bool:
        """Right, or with a rest, or with a rest another law of the same family."""
        return self.right_with_rest or (bool(self.dominant) and {self.dominant} <= self.akin)

    @property
    def akin(self) -> frozenset[str]:
        """Return the truth, with the laws of its family."""
        return self.truth.union(*(laws for laws in FAMILIES if self.truth & laws))

    @property
    def truth(self) -> frozenset[str]:
        """Return the names of what is hidden."""
        return frozenset(self.label.effects)

    @property
    def right(self) -> bool:
        """Exactly the truth; or a twin in its place, if the truth is given as confusable with it."""
        if self.named == self.truth:
            return True
        return len(self.named) == len(self.truth) and self.named <= acceptable(self) and self.in_set

    @property
    def in_set(self) -> bool:
        """Return whether the truth is named, or given as confusable."""
        told = {rival["name"] for rival in self.verdict.get("confusable_with", [])}
        return self.says == "effects" and self.truth <= self.named | told

    @property
    def answer(self) -> str:
        """In one word."""
        if self.dominant:
            return f"{self.dominant} with a rest"
        return "+".join(sorted(self.named)) if self.says == "effects" else self.says

    @property
    def question(self) -> str:
        """Say what was hidden."""
        if self.label.outside:
            return f"outside: {self.label.outside}"
        return "+".join(sorted(self.truth)) or "none"


def as_wanted(j: Judged) -> bool:
    """Tell whether a case ended as it should; an effect that cannot be seen need not be named."""
    if j.label.outside:
        return j.says == "unknown" or (not j.label.visible and j.says == "none")
    if j.label.hides == "nothing":
        return j.says == "none"
    if j.label.rest and j.right_with_rest:
        return True
    seen = {name for name, found in j.label.visibility.items() if found.visible}
    if seen and seen <= j.named <= j.truth:
        return True
    return j.right or (not j.label.visible and j.says in ("none", "unknown"))


@dataclass(frozen=True)
class Rate:
    """How many of how many, against an aim."""

    title: str
    hits: int
    total: int
    aim: str
    good: Callable[[float], bool]

    @property
    def share(self) -> float:
        """Return the share."""
        return self.hits / self.total if self.total else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Return Wilson's 95 % interval."""
        return wilson(self.hits, self.total)

    @property
    def verdict(self) -> str:
        """Whether the aim is reached, and whether the cases are enough to say so."""
        if self.total == 0:
            return "not tested"
        reached = self.good(self.share)
        sure = all(self.good(end) == reached for end in self.interval)
        return f"{'reached' if reached else 'missed'}{'' if sure else ', not surely'}"


def wilson(hits: int, total: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson, 1927)."""
    if total == 0:
        return 0.0, 1.0
    interval = binomtest(hits, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def rates(judged: Sequence[Judged]) -> list[Rate]:
    """Every aim of the blind test that is a share."""
    nothing = [j for j in judged if j.label.hides == "nothing"]
    single = [j for j in judged if j.label.hides == "single"]
    visible = [j for j in single if j.label.visible]
    outside = [j for j in judged if j.label.outside and j.label.visible]
    pairs = [j for j in judged if j.label.hides == "pair" and j.label.visible]
    covered = [e.covered for e in numbers(judged)]
    near = [abs(e.error) <= 0.03 for e in numbers(judged)]

    def rate(title: str, hits: Sequence[bool], aim: float, most: bool = False) -> Rate:
        sense = "≤" if most else "≥"
        good: Callable[[float], bool] = (lambda x: x <= aim) if most else (lambda x: x >= aim)
        return Rate(title, sum(hits), len(hits), f"{sense} {100 * aim:g} %", good)

    coverage = Rate("true values inside the 90 % interval", sum(covered), len(covered), "85-95 %", _ninety)
    return [
        rate("top-1, visible single effects", [j.right for j in visible], 0.95),
        rate("top-1, alone or with a rest, visible single effects", [j.right_with_rest for j in visible], 0.95),
        rate("the same, or another law of its family with a rest", [j.right_by_family for j in visible], 0.95),
        rate("a wrong name alone", [_wrong_alone(j) for j in single], 0.01, True),
        rate("truth in the returned set, visible single effects", [j.in_set for j in visible], 0.98),
        rate("false alarms (nothing hidden)", [j.says == "effects" for j in nothing], 0.02, True),
        rate("nothing hidden and `none` said", [j.says == "none" for j in nothing], 0.98),
        rate("outside the catalogue and `unknown` said", [j.says == "unknown" for j in outside], 0.92),
        rate("pairs, both found", [j.right for j in pairs], 0.85),
        rate("pairs, a wrong name among those found", [bool(j.named - acceptable(j)) for j in pairs], 0.0, True),
        coverage,
        rate("numbers within 3 % of the truth (half of them: the median is)", near, 0.5),
    ]


def _ninety(share: float) -> bool:
    return 0.85 <= share <= 0.95


def _wrong_alone(j: Judged) -> bool:
    named = j.named | ({j.dominant} if j.dominant else set())
    return bool(named) and not named & (acceptable(j) | (j.akin if j.dominant else frozenset()))


def acceptable(j: Judged) -> frozenset[str]:
    """Return what may be named."""
    return j.truth | frozenset(j.label.alike)


@dataclass(frozen=True)
class NumberError:
    """How far one number is off."""

    key: str
    error: float  # relative to the truth
    covered: bool


def numbers(judged: Sequence[Judged]) -> list[NumberError]:
    """Return the numbers of rightly named effects whose truth has the file's terms, and is not zero."""
    return [e for j in judged if j.named == j.truth for e in _numbers_of(j)]


def _numbers_of(j: Judged) -> Iterator[NumberError]:
    told = {effect["name"]: effect["parameters"] for effect in j.verdict.get("effects", [])}
    also = {} if "guide_damping" in j.label.effects else {k: x for k, x in j.label.also.items() if k in told}
    for name, table in {**j.label.effects, **also}.items():
        for key, true in table.items():
            if key == "direction" or key in INEXACT.get(name, ()):
                continue
            found = told[name].get(key)
            if found is not None:
                yield from _compared(f"{name}.{key}", true, found, KINDS[j.label.machine].moving)


def _compared(key: str, true: Any, found: Mapping[str, Any], moving: Sequence[float]) -> Iterator[NumberError]:
    """One number, or three by key[0], key[1], key[2]; one stands for three equal ones, of those that move."""
    told_once = not isinstance(true, list) and isinstance(found["value"], list)
    several = any(isinstance(x, list) for x in (true, found["value"]))
    parts = [np.broadcast_to(x, 3 if several else 1) for x in (true, found["value"], found["low"], found["high"])]
    for n, (value, said, low, high) in enumerate(zip(*parts, strict=True)):
        if value != 0.0 and (moving[n] or not told_once):  # none has a size to be off by
            name = f"{key}[{n}]" if several else key
            yield NumberError(name, float(said / value - 1), bool(low <= value <= high))


def confusion(judged: Sequence[Judged]) -> dict[str, Counter[str]]:
    """Truth → how often each answer was given; pairs are one row, by how many were found."""
    table: dict[str, Counter[str]] = {}
    for j in judged:
        row, answer = j.question, j.answer
        if j.label.hides == "pair":
            row = "a pair"
            found, extra = len(j.truth & j.named), len(j.named - j.truth)
            answer = f"{found} right, {extra} wrong" if j.says == "effects" else j.says
        table.setdefault(row, Counter())[answer] += 1
    return table


def miss(j: Judged) -> dict[str, Any]:
    """Describe a case with a wrong answer."""
    return {
        "case": j.name,
        "stratum": j.label.stratum,
        "hidden": j.question,
        "left": [math.sqrt(max(v.left, 0.0) / v.rows) for v in j.label.visibility.values()],
        "visible": j.label.visible,
        "said": j.answer,
        "because": _because(j),
    }


def _because(j: Judged) -> str:
    refused = j.verdict.get("refused") or {}
    rivals = ", ".join(rival["name"] for rival in j.verdict.get("confusable_with", []))
    parts = [j.verdict.get("why", "").replace("\n", " ").replace("|", "/")]
    if refused:
        parts.append(f"nearest {'+'.join(refused['effects'])}; {'; '.join(refused['because'])}")
    if rivals:
        parts.append(f"looks alike: {rivals}")
    return "; ".join(filter(None, parts))
