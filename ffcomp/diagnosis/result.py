"""A diagnosis in the terms of the machine file: effects with intervals, retuned parameters, residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ffcomp.diagnosis.acceptance import undetermined
from ffcomp.diagnosis.candidates import WHOLE, effect_tables
from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.fit import Fit
from ffcomp.diagnosis.held_out import OtherMotion
from ffcomp.diagnosis.next_experiment import Separation
from ffcomp.diagnosis.problem import MachineNames, Problem
from ffcomp.diagnosis.recording_clocks import belongs_to_recording, delay_of
from ffcomp.diagnosis.residual_curves import ResidualCurve, curves_of
from ffcomp.diagnosis.score_test import separated_by
from ffcomp.diagnosis.where import ResidualBreakdown, ResidualSize, locate_residual
from ffcomp.identification.uncertainty import Estimate
from ffcomp.numerics.serialise import ALL_OF, keys
from models.effects.catalogue import CATALOGUE, key_in_file
from models.file import updated_text

LATE_S = 1e-4  # a later file is reported
OFF_SHARE = 0.05  # of a number of the file: a larger error is reported
BEYOND_SD = 3.0  # by chance one of fifteen numbers is so far off in one machine of 25


@dataclass(frozen=True, kw_only=True)
class Gap:
    """The discrepancy in units of the signals, before and after, where it was fitted and where it was left out."""

    before: ResidualSize
    after: ResidualSize
    elsewhere: tuple[float, float]  # nrms before and after, at positions that were left out of the fit
    left_out: str = "places"  # left out of the fit in turn: places, experiments, windows, or nothing ("")
    unproven: Sequence[str] = ()  # places or experiments where it is not explained
    noise_guessed: bool = False  # no motion was repeated, and no sensor shows its own

    json_keys: ClassVar = keys("noise", before="before.nrms", after="after.nrms") | {
        "held_out.before": "elsewhere.0",
        "held_out.after": "elsewhere.1",
        "held_out.noise": "noise",
    }

    @property
    def noise(self) -> float:
        """The nrms of the noise alone."""
        return self.before.noise_nrms

    @property
    def explained(self) -> float:
        """Share of the discrepancy above the noise that is explained, in power."""
        return _explained(self.before.nrms, self.after.nrms, self.noise)

    @property
    def explained_elsewhere(self) -> float:
        """The same where it was left out of the fit."""
        return _explained(*self.elsewhere, self.noise)

    @property
    def closed(self) -> bool:
        """Whether there is a gap, and half of it is closed, also where it was left out of the fit."""
        gap, left = self.before.nrms - self.noise, self.after.nrms - self.noise
        gap_elsewhere, left_elsewhere = (x - self.noise for x in self.elsewhere)
        return gap > 0.1 * self.noise and left < 0.5 * gap and left_elsewhere < 0.5 * gap_elsewhere


def _explained(before: float, after: float, noise: float) -> float:
    # an axis that nothing holds may be simulated worse than one that stands still: that is no measure
    gap, left = min(before, 1.0) ** 2 - noise**2, after**2 - noise**2
    return 1 - max(left, 0.0) / gap if gap > 0 else 0.0


@dataclass(frozen=True, slots=True)
class Change:
    """A number of the machine file, and what fits."""

    json_keys: ClassVar = {"from": "filed", "to": "fitted"}

    filed: float
    fitted: float


@dataclass(frozen=True, kw_only=True)
class FileNumbers:
    """Changes of the machine file's own numbers."""

    retuned: Mapping[str, Change] = field(default_factory=dict)
    off: Mapping[str, Change] = field(default_factory=dict)  # those that alone would explain as much
    beyond: Mapping[str, float] = field(default_factory=dict)  # retuned by so many of their uncertainties


@dataclass(frozen=True, kw_only=True)
class Rest:
    """What one effect that holds most of a discrepancy leaves."""

    explained: float  # share of the discrepancy that the effect explains where it was left out of the fit
    left: ResidualBreakdown
    rivals: Sequence[tuple[tuple[str, ...], float]] = ()  # effects of other families, and what they explain there


@dataclass(frozen=True, slots=True)
class Interval:
    """A parameter in the machine file's terms, with its 90 % interval; lists where the file has lists."""

    value: Any
    low: Any
    high: Any


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An effect that is named."""

    name: str
    family: str  # what it is, whatever its law; or its name
    parameters: Mapping[str, Interval]  # by the machine file's key
    confidence: float
    evidence: float


@dataclass(frozen=True, slots=True)
class Dominant:
    """An effect that is named with a rest."""

    json_keys: ClassVar = {ALL_OF: "effect"} | keys(explained="rest.explained", left="rest.left", rivals="rest.rivals")

    effect: FoundEffect
    rest: Rest


@dataclass(frozen=True, slots=True)
class Confusable:
    """An effect that looks alike in these runs."""

    name: str
    separate_by: str  # how to separate them


@dataclass(frozen=True, slots=True)
class Nearest:
    """What came nearest, and why it does not explain all."""

    effects: Sequence[str]
    because: Sequence[str]


@dataclass(frozen=True, eq=False, kw_only=True)
class DiagnosisResult:
    """The contents of the answer and of the better machine file."""

    json_keys: ClassVar = keys(
        *("verdict", "finding", "dominant", "undetermined", "refused", "invisible", "late_s", "cut_short", "gap"),
        effects="found",
        residual_curves="curves",
        retuned="file.retuned",
        separate="separations",
        confusable_with="confounded_with",
        left_out="gap.left_out",
        unproven_at="gap.unproven",
        or_file_off="file.off",
        other_motions="others",
        compared="compared_kind",
    )

    verdict: str  # "effects", "none" or "unknown"
    finding: str  # the verdict more closely, see diagnosis.FINDINGS
    fault: str = ""  # of the recordings: a sentence
    effects: Mapping[str, Mapping[str, Any]]  # of the best hypothesis, as tables of a machine file
    intervals: Mapping[str, Estimate]  # effects.name.key -> in the machine file's terms
    confidence: Mapping[str, float]  # of each effect against the best that was tried without it
    evidence: float  # −2 ln Z gained against retuning alone
    others: Sequence[OtherMotion] = ()  # motions of an axis, each simulated with what was fitted to the others
    rejections: Sequence[str] = ()
    invisible: Sequence[str] = ()  # effects whose usual size the recordings could not show
    confounded_with: Sequence[Confusable] = ()
    separations: Sequence[Separation] = ()  # from what fits as well
    prints_worse: bool = False  # by the better file, as the sample print is predicted
    gap: Gap
    rest: Rest | None = None  # of an effect that is named with a rest
    curves: Sequence[ResidualCurve] = ()  # of what is not explained
    undetermined: Sequence[str] = ()  # numbers of the effects at their bounds, or open over all of their range
    scattered: Sequence[str] = ()  # numbers whose intervals are wide because few motions scatter
    motions: int = 0  # different ones, in the recordings
    file: FileNumbers
    names: MachineNames = field(default_factory=MachineNames)
    late_s: Mapping[str, float] = field(default_factory=dict)  # files that lie off their command by more than 0.1 ms
    cut_short: bool = False  # the search ended at its budget
    forces: bool = False  # compared are forces, see `Problem.forces`

    @property
    def compared(self) -> str:
        """Say what is compared."""
        return "the drive's forces" if self.forces else "the signals"

    @property
    def compared_kind(self) -> str:
        """The same in a word."""
        return "forces" if self.forces else "signals"

    @property
    def found(self) -> list[FoundEffect]:
        """The effects, where the verdict is that they are missing."""
        return [self.effect(name) for name in self.effects] if self.verdict == "effects" else []

    @property
    def dominant(self) -> Dominant | None:
        """The effect that is named with a rest."""
        return None if self.rest is None else Dominant(self.effect(self.named[0]), self.rest)

    @property
    def refused(self) -> Nearest | None:
        """What came nearest, if anything speaks against it."""
        return Nearest([*self.effects], self.rejections) if self.rejections else None

    def effect(self, name: str) -> FoundEffect:
        """Return one of the effects."""
        family = CATALOGUE[name].family or name
        return FoundEffect(name, family, self.parameters(name), self.confidence[name], self.evidence)

    @property
    def named(self) -> tuple[str, ...]:
        """The effects that are named: all there are, or the one that holds most of the gap."""
        return tuple(self.effects) if self.verdict == "effects" or self.rest is not None else ()

    @property
    def mends(self) -> bool:
        """Whether a better file exists: with effects, or with retuned parameters that suffice also elsewhere."""
        if self.verdict != "none":
            return bool(self.named)
        return not self.late_s and bool(self.gap.left_out) and self.gap.closed

    def parameters(self, effect: str) -> dict[str, Interval]:
        """Return value, low and high of one effect by the machine file's keys; lists where the file has lists."""
        prefix, estimates = f"effects.{effect}.", dict[str, dict[int, Estimate]]()
        for name, e in self.intervals.items():
            if name.startswith(prefix):
                key, _, index = name.removeprefix(prefix).rstrip("]").partition("[")
                estimates.setdefault(key, {})[int(index or 0)] = e
        quantities = self.names.quantities
        return {
            key_in_file(effect, key, quantities): Interval(
                *(quantities.value(key, number) for number in _in_file(effect, key, each, self.effects[effect][key]))
            )
            for key, each in estimates.items()
            if key != WHOLE
        }


def result_of(problem: Problem, diagnosis: Diagnosis) -> DiagnosisResult:
    """Translate a diagnosis; the best hypothesis is reported even if it was rejected."""
    fitted = diagnosis.final
    tables = effect_tables(fitted.values) if diagnosis.best is not None else {}
    catalogue = problem.names.catalogue
    more = "more places and at several speeds" if catalogue is CATALOGUE else "several speeds and sizes"
    before, after = (
        locate_residual(problem, diagnosis.estimation.whiten, diagnosis.noise, problem.simulate(values))
        for values in ({}, fitted.values)
    )
    key = problem.names.quantities.key
    dominant, noise = diagnosis.dominant, before.total.noise_nrms
    moved = [
        (n.name, float(z), Change(n.start, problem.stated(fitted.values, n.name)))
        for n, z in zip(fitted.parameters, fitted.z, strict=True)
        if of_machine(n.name)
    ]
    return DiagnosisResult(
        verdict=diagnosis.verdict,
        finding=diagnosis.finding,
        fault="" if diagnosis.fault is None else diagnosis.fault.sentence(),
        effects=tables,
        intervals={n: _in_file_terms(n, e) for n, e in diagnosis.intervals.items() if n.startswith("effects.")},
        confidence={name: _confidence(diagnosis, name) for name in tables},
        evidence=fitted.ahead_of(diagnosis.base),
        others=[replace(o, number=key(o.number).removeprefix("effects.")) for o in diagnosis.others],
        rejections=[problem.names.quantities.sentence(each) for each in diagnosis.rejections],
        invisible=diagnosis.invisible,
        confounded_with=[
            Confusable(n, separated_by(tuple(tables), [n], catalogue) or f"Runs at {more}.")
            for n in diagnosis.confounded
        ],
        gap=Gap(
            before=before.total,
            after=after.total,
            elsewhere=_elsewhere(diagnosis, noise),
            left_out=_left_out(diagnosis),
            unproven=[place.label for place in diagnosis.unproven],
            noise_guessed=not (diagnosis.noise.from_repeats or diagnosis.noise.of_sensors),
        ),
        rest=None
        if dominant is None
        else Rest(explained=dominant.explained, left=after, rivals=[(r.names, r.explained) for r in dominant.rivals]),
        curves=curves_of(diagnosis),
        undetermined=[]
        if diagnosis.best is None
        else [key(name).removeprefix("effects.") for name in undetermined(diagnosis.best, diagnosis.intervals)],
        scattered=[key(name).removeprefix("effects.") for name in diagnosis.scattered if name.startswith("effects.")],
        motions=len(set(problem.motions)),
        file=FileNumbers(
            retuned={key(name): values for name, z, values in moved if z},
            off={} if diagnosis.file_off is None else {key(n): x for n, x in _off(diagnosis.file_off).items()},
            beyond={
                key(name): abs(z) for name, z, _ in sorted(moved, key=lambda each: -abs(each[1])) if abs(z) > BEYOND_SD
            },
        ),
        names=problem.names,
        late_s=_late(problem, diagnosis),
        cut_short=diagnosis.cut_short,
        forces=problem.forces,
    )


def of_machine(name: str) -> bool:
    """Tell whether a fitted parameter is one of the machine file's own numbers."""
    return not (name.startswith("effects.") or belongs_to_recording(name))


def _left_out(diagnosis: Diagnosis) -> str:
    if not diagnosis.held_out:
        return "" if diagnosis.best is not None or diagnosis.verdict == "none" else "places"
    if len(diagnosis.held_out[0].position) == 1:
        return "windows"
    return "experiments" if diagnosis.held_out[0].experiment else "places"


def _elsewhere(diagnosis: Diagnosis, noise: float) -> tuple[float, float]:
    """Compute nrms over all positions, each left out of the fit in turn: with the original file, and with the fit."""
    if not diagnosis.held_out:
        return noise, noise
    filed, after, signals = np.sum([place.power for place in diagnosis.held_out], axis=0)
    return float(np.sqrt(filed / signals)), float(np.sqrt(after / signals))


def _late(problem: Problem, diagnosis: Diagnosis) -> dict[str, float]:
    """Return how late files lie: the lags between repeats plus the fitted delay."""
    values = diagnosis.final.values if diagnosis.best is not None else diagnosis.base.values
    late = {}
    for i, o in enumerate(problem.observations):
        delays = [
            _lag(problem, i, o.signals[members[0]]) + delay_of(values, o, clock)
            for clock, members in o.by_clock.items()
        ]
        most = max(delays, key=abs)
        if abs(most) > LATE_S:
            late[Path(o.name).name] = most
    return late


def _lag(problem: Problem, i: int, signal: str) -> float:
    """Return how late a signal of an observation is behind its repeats, s."""
    apart = (each for each in problem.repeats if each.apart and i in each.members)
    lags = (each.lag_s[each.members.index(i)] for each in apart if signal in each.signals or not each.signals)
    return next(lags, 0.0)


def _off(fitted: Fit) -> dict[str, Change]:
    """Return the machine's numbers that would have to be wrong instead, those that move most first."""
    moved = sorted(zip(fitted.parameters, fitted.z, strict=True), key=lambda each: -abs(each[1]))
    numbers = [(n, fitted.values[n.name]) for n, _ in moved if of_machine(n.name) and n.start]
    return {n.name: Change(n.start, x) for n, x in numbers if abs(x / n.start - 1) > OFF_SHARE}


def _confidence(diagnosis: Diagnosis, effect: str) -> float:
    """Compute the probability against the best hypothesis without its cause, both equally likely beforehand."""
    if diagnosis.best is None:
        return 0.0
    fitted = diagnosis.best.fit
    behind = [diagnosis.behind(h) for h in diagnosis.tried if CATALOGUE[effect].cause not in h.causes]
    nearest = min([*behind, fitted.ahead_of(diagnosis.base)])
    sure = float(1 / (1 + np.exp(-np.clip(nearest / 2, -50, 50))))
    # tested at one place, or wrong numbers of the file would explain as much: at most so sure
    tested = 1.0 if _left_out(diagnosis) in ("places", "windows") else 0.9
    return min(sure, tested, 1.0 if diagnosis.file_off is None else 0.5)


def _in_file_terms(name: str, e: Estimate) -> Estimate:
    """Convert back from value ** power, which reverses an interval if the power is negative."""
    _, effect, key = name.split(".")
    key = key.partition("[")[0]
    if key != WHOLE and CATALOGUE[effect].parameter(key).logarithmic:
        return Estimate(math.exp(e.value), e.sd * math.exp(e.value), math.exp(e.low), math.exp(e.high))
    power = 1 if key == WHOLE else CATALOGUE[effect].parameter(key).power
    if power == 1 or e.value <= 0:
        return e
    value, ends = e.value ** (1 / power), [max(x, 1e-12) ** (1 / power) for x in (e.low, e.high)]
    return Estimate(value, value * e.sd / e.value / abs(power), min(ends), max(ends))


def _in_file(effect: str, key: str, estimates: Mapping[int, Estimate], table: Any) -> tuple[Any, Any, Any]:
    """Return value, low and high of one key.

    Parameters
    ----------
    estimates : by their places in a list.
    table : the key's value in the machine file.
    """
    if CATALOGUE[effect].parameter(key).size == "direction":
        first = estimates[0]
        ends = [[round(math.cos(x), 6), round(math.sin(x), 6)] for x in (first.low, first.high)]
        low, high = (table, table) if isinstance(table, str) else ends
        return table, low, high
    told = table if isinstance(table, list) else [table]  # actuators that rested in all recordings have no estimate
    value, low, high = (
        [float(getattr(estimates[i], what)) if i in estimates else x for i, x in enumerate(told)]
        for what in ("value", "low", "high")
    )
    return (value, low, high) if len(value) > 1 else (value[0], low[0], high[0])


def better_file(source: Path, name: str, result: DiagnosisResult, data: Sequence[str], when: str) -> str:
    """Write the machine file with the named effects, the retuned parameters and their provenance; comments survive."""
    quantities = result.names.quantities
    values: dict[str, Any] = {key: float(f"{each.fitted:.6g}") for key, each in result.file.retuned.items()}
    for effect, table in result.effects.items():
        if not table:
            values[f"effects.{effect}"] = {}
        for key, value in table.items():  # of an axis by itself `updated_text` knows the keys
            written = key_in_file(effect, key, quantities) if quantities.per_kilogram else key
            values[f"effects.{effect}.{written}"] = _rounded(value)
    entry = {
        "date": when,
        "started_from": source.stem,
        "data": list(data),
        "intervals_90_percent": {
            quantities.key(n): f"{quantities.scale(n) * e.low:.4g} to {quantities.scale(n) * e.high:.4g}"
            for n, e in result.intervals.items()
        },
        "gap_nrms_before": float(f"{result.gap.before.nrms:.4g}"),
        "gap_nrms_after": float(f"{result.gap.after.nrms:.4g}"),
        "gap_nrms_noise": float(f"{result.gap.noise:.4g}"),
        "held_out_nrms_before_after": [float(f"{x:.4g}") for x in result.gap.elsewhere],
    }
    if result.rest is not None:
        entry["explains_of_the_gap_elsewhere"] = float(f"{result.rest.explained:.3g}")
    return updated_text(source, values, name=name, provenance={"diagnosed": entry})


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(x) for x in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value
