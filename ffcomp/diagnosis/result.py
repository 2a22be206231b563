"""A diagnosis in the terms of the machine file: effects with intervals, retuned parameters, residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ffcomp.diagnosis.acceptance import undetermined
from ffcomp.diagnosis.candidates import IN_FILE, effect_tables, file_value
from ffcomp.diagnosis.diagnosis import Outcome
from ffcomp.diagnosis.fit import Fit
from ffcomp.diagnosis.next_experiment import Separation
from ffcomp.diagnosis.problem import Problem
from ffcomp.diagnosis.recording_clocks import belongs_to_recording, delay_of
from ffcomp.diagnosis.score_test import separated_by
from ffcomp.diagnosis.where import ResidualBreakdown, ResidualCurve, locate_residual, residual_curves
from ffcomp.identification.machine_fit import Origin
from ffcomp.identification.uncertainty import Estimate
from ffcomp.numerics.serialise import ALL_OF, keys
from models.effects.catalogue import CATALOGUE, key_in_file
from models.file import updated_text
from models.quantities import Quantities

LATE_S = 1e-4  # a later file is reported
OFF_SHARE = 0.05  # of a number of the file: a larger error is reported
BEYOND_SD = 2.99  # where retuning ends; by chance one of fifteen numbers is so far off in one machine of 25


@dataclass(frozen=True, kw_only=True)
class Gap:
    """The discrepancy in units of the signals, before and after, where it was fitted and where it was left out."""

    before: float  # nrms
    after: float
    noise: float  # nrms of the noise alone
    elsewhere: tuple[float, float]  # nrms before and after, at positions that were left out of the fit
    left_out: str = "places"  # left out of the fit in turn: places, experiments, windows, or nothing ("")

    json_keys: ClassVar = keys("noise", "before", "after") | {
        "held_out.before": "elsewhere.0",
        "held_out.after": "elsewhere.1",
        "held_out.noise": "noise",
    }

    @property
    def explained(self) -> float:
        """Share of the discrepancy above the noise that is explained, in power."""
        return _explained(self.before, self.after, self.noise)

    @property
    def explained_elsewhere(self) -> float:
        """The same where it was left out of the fit."""
        return _explained(*self.elsewhere, self.noise)

    @property
    def closed(self) -> bool:
        """Whether there is a gap, and half of it is closed, also where it was left out of the fit."""
        gap, left = self.before - self.noise, self.after - self.noise
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
    confidence: float  # posterior probability, of all that was tried
    evidence: float  # −2 ln Z gained against retuning alone, of all effects


@dataclass(frozen=True, slots=True)
class PartlyExplained:
    """The effect that holds most of a discrepancy, and what it leaves."""

    json_keys: ClassVar = {ALL_OF: "effect"} | keys("explained", "left", "rivals", "signal")

    effect: FoundEffect
    explained: float  # of the discrepancy, by the amplitude averaged over frequency, where it was left out of the fit
    left: ResidualBreakdown
    rivals: Sequence[tuple[tuple[str, ...], float]]  # effects of other families, and what they explain there
    signal: str = ""  # whose gap that is; "": of all signals


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


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class DiagnosisResult:
    """The contents of the answer and of the better machine file; the best hypothesis even if it was rejected."""

    json_keys: ClassVar = keys(
        "verdict",
        finding="search.finding",
        dominant="dominant",
        undetermined="undetermined",
        refused="refused",
        invisible="search.invisible",
        late_s="late_s",
        cut_short="search.cut_short",
        gap="gap",
        effects="found",
        residual_curves="curves",
        retuned="retuned",
        separate="separations",
        confusable_with="confounded_with",
        left_out="gap.left_out",
        unproven_at="unproven",
        or_file_off="file_off",
        other_motions="search.others",
        compared="compared",
    )

    search: Outcome  # everything that the verdict rests on
    separations: Sequence[Separation] = ()  # what to record, to separate explanations that fit as well

    @property
    def problem(self) -> Problem:
        """What was compared."""
        return self.search.whole.problem

    @property
    def verdict(self) -> str:
        """Return "effects", "none" or "unknown"."""
        return self.search.verdict

    @property
    def compared(self) -> str:
        """What is compared: the signals, or the drive's forces."""
        return "forces" if self.problem.forces else "signals"

    # ---- effects ----

    @cached_property
    def effects(self) -> dict[str, dict[str, Any]]:
        """The effects of the best hypothesis, as tables of a machine file."""
        return effect_tables(self.search.final.values) if self.search.best is not None else {}

    @property
    def named(self) -> tuple[str, ...]:
        """The effects that are named: all there are, or the one that holds most of the gap."""
        return tuple(self.effects) if self.verdict == "effects" or self.search.dominant is not None else ()

    @property
    def found(self) -> list[FoundEffect]:
        """The effects, where the verdict is that they are missing."""
        return [self._effect(name) for name in self.effects] if self.verdict == "effects" else []

    @property
    def dominant(self) -> PartlyExplained | None:
        """The effect that is named with a rest."""
        if (most := self.search.dominant) is None:
            return None
        rivals = [(r.names, r.explained) for r in most.rivals]
        return PartlyExplained(self._effect(self.named[0]), most.explained, self.residuals[1], rivals, most.signal)

    @property
    def refused(self) -> Nearest | None:
        """What came nearest, if anything speaks against it."""
        because = [self.problem.quantities.sentence(each) for each in self.search.rejections]
        return Nearest([*self.effects], because) if because else None

    def _effect(self, name: str) -> FoundEffect:
        family, search = CATALOGUE[name].family or name, self.search
        ahead = search.final.ahead_of(search.base)
        return FoundEffect(name, family, self.parameters(name), self._confidence(name), ahead)

    def _confidence(self, effect: str) -> float:
        """Return the posterior probability of its cause."""
        # tested at one place, or wrong numbers of the file would explain as much: at most so sure
        tested = 1.0 if self.gap.left_out in ("places", "windows") else 0.9
        return min(self.search.posterior(CATALOGUE[effect].cause), tested, 1.0 if self.search.file_off is None else 0.5)

    def parameters(self, effect: str) -> dict[str, Interval]:
        """Return value, low and high of one effect by the machine file's keys."""
        quantities, found = self.problem.quantities, {}
        for key, table in self.effects[effect].items():
            interval = self._interval(effect, key, table)
            ends = (quantities.value(key, x) for x in (interval.value, interval.low, interval.high))
            found[key_in_file(effect, key, quantities)] = Interval(*ends)
        return found

    def _interval(self, effect: str, key: str, table: Any) -> Interval:
        """Return the interval of one key; `table` : its value in the machine file."""
        name = f"effects.{effect}.{key}"
        if (shape := CATALOGUE[effect].by_name[key]).size == "direction":
            angle = self.intervals[name]
            return Interval(table, file_value(shape, angle.low), file_value(shape, angle.high))
        if not isinstance(table, list):
            return self.intervals[name]
        # actuators that rested in all recordings have no estimate
        each = [self.intervals.get(f"{name}[{i}]", Interval(x, x, x)) for i, x in enumerate(table)]
        if len(each) == 1:
            return each[0]
        return Interval([x.value for x in each], [x.low for x in each], [x.high for x in each])

    @cached_property
    def intervals(self) -> dict[str, Interval]:
        """By `effects.name.key`, in the machine file's terms."""
        return {n: _in_file_terms(n, e) for n, e in self.search.intervals.items() if n.startswith("effects.")}

    @property
    def undetermined(self) -> list[str]:
        """Numbers of the effects at their bounds, or open over all of their range."""
        best = self.search.best
        numbers = [] if best is None else undetermined(best, self.search.intervals)
        return [self.problem.quantities.key(n.name).removeprefix("effects.") for n in numbers]

    @property
    def confounded_with(self) -> list[Confusable]:
        """Effects that look alike in these runs."""
        catalogue = self.problem.catalogue
        more = "more places and at several speeds" if catalogue is CATALOGUE else "several speeds and sizes"
        return [
            Confusable(name, separated_by(tuple(self.effects), [name], catalogue) or f"Runs at {more}.")
            for name in self.search.confounded
        ]

    # ---- the gap ----

    @cached_property
    def residuals(self) -> tuple[ResidualBreakdown, ResidualBreakdown]:
        """With the original machine file, and with the final fit."""
        problem, search = self.problem, self.search
        before, after = (
            locate_residual(problem, search.whole.whiten, search.noise, problem.simulate(values))
            for values in ({}, search.final.values)
        )
        return before, after

    @cached_property
    def gap(self) -> Gap:
        """The discrepancy before and after."""
        before, after = (each.total.nrms for each in self.residuals)
        noise, held_out = self.residuals[0].total.noise_nrms, self.search.held_out
        elsewhere = noise, noise
        if held_out:  # each left out of the fit in turn
            filed, fitted, signals, _ = np.sum([place.power for place in held_out], axis=0)
            elsewhere = float(np.sqrt(filed / signals)), float(np.sqrt(fitted / signals))
        return Gap(before=before, after=after, noise=noise, elsewhere=elsewhere, left_out=self._left_out)

    @property
    def _left_out(self) -> str:
        if not (held_out := self.search.held_out):
            return "" if self.search.best is not None or self.verdict == "none" else "places"
        if len(held_out[0].position) == 1:
            return "windows"
        return "experiments" if held_out[0].experiment else "places"

    @property
    def unproven(self) -> list[str]:
        """Places or experiments where it is not explained."""
        return [place.label for place in self.search.unproven]

    @cached_property
    def curves(self) -> list[ResidualCurve]:
        """Of what is not explained: what an effect leaves that holds most, else what the original file leaves."""
        if self.search.finding not in ("dominant", "unproven", "unexplained"):
            return []
        values = self.search.final.values if self.search.finding == "dominant" else {}
        return residual_curves(self.problem, values, self.search.noise)

    # ---- the file's own numbers ----

    @property
    def mends(self) -> bool:
        """Whether a better file exists: with effects, or with retuned parameters that suffice also elsewhere."""
        if self.verdict != "none":
            return bool(self.named)
        return not self.late_s and bool(self.gap.left_out) and self.gap.closed

    @property
    def retuned(self) -> dict[str, Change]:
        """By key, those that moved."""
        return {key: change for key, z, change in self._moved(self.search.final) if z}

    @property
    def beyond(self) -> dict[str, float]:
        """By how many of their uncertainties those moved that moved far."""
        return {key: abs(z) for key, z, _ in self._moved(self.search.final) if abs(z) > BEYOND_SD}

    @property
    def file_off(self) -> dict[str, Change]:
        """Those that alone would explain as much, if they were wrong."""
        numbers = self._moved(self.search.file_off) if self.search.file_off is not None else []
        return {key: x for key, _, x in numbers if x.filed and abs(x.fitted / x.filed - 1) > OFF_SHARE}

    def _moved(self, fitted: Fit) -> list[tuple[str, float, Change]]:
        """Return the file's own numbers, those that moved furthest first: key, standard deviations, change."""
        numbers = []
        for n, z in zip(fitted.parameters, fitted.z, strict=True):
            if of_machine(n.name):
                scale = self.problem.quantities.scale(n.name)
                change = Change(scale * n.start, scale * self.problem.stated(fitted.values, n.name))
                numbers.append((file_key(n.name, self.problem.quantities), float(z), change))
        return sorted(numbers, key=lambda each: -abs(each[1]))

    @cached_property
    def late_s(self) -> dict[str, float]:
        """By how much files lie off their command: the lags between repeats plus the fitted delay."""
        fitted = self.search.final if self.search.best is not None else self.search.base
        late = {}
        for i, o in enumerate(self.problem.observations):
            delays = [
                _lag(self.problem, i, o.signals[members[0]]) + delay_of(fitted.values, o, clock)
                for clock, members in o.by_clock.items()
            ]
            most = max(delays, key=abs)
            if abs(most) > LATE_S:
                late[Path(o.name).name] = most
        return late

    def better_file(self, name: str, data: Sequence[str]) -> str:
        """Write the machine file with the named effects and retuned parameters; `data` : files with their hashes."""
        quantities, gap, origin = self.problem.quantities, self.gap, Origin(self.problem.machine, name, data)
        values: dict[str, Any] = {key: float(f"{each.fitted:.6g}") for key, each in self.retuned.items()}
        for effect, table in self.effects.items():
            if not table:
                values[f"effects.{effect}"] = {}
            for key, value in table.items():  # of an axis by itself `updated_text` knows the keys
                written = key_in_file(effect, key, quantities) if quantities.per_kilogram else key
                values[f"effects.{effect}.{written}"] = _rounded(value)
        entry = origin.table(
            intervals_90_percent={
                quantities.key(n): f"{quantities.scale(n) * e.low:.4g} to {quantities.scale(n) * e.high:.4g}"
                for n, e in self.intervals.items()
            },
            gap_nrms_before=float(f"{gap.before:.4g}"),
            gap_nrms_after=float(f"{gap.after:.4g}"),
            gap_nrms_noise=float(f"{gap.noise:.4g}"),
            held_out_nrms_before_after=[float(f"{x:.4g}") for x in gap.elsewhere],
        )
        if self.search.dominant is not None:
            entry["explains_of_the_gap_elsewhere"] = float(f"{self.search.dominant.explained:.3g}")
        return updated_text(Path(origin.start.path), values, name=name, provenance={"diagnosed": entry})


def file_key(name: str, quantities: Quantities) -> str:
    """Return the key of one of the machine's numbers in its file."""
    if not name.startswith(IN_FILE):
        return quantities.key(name)
    _, effect, key = name.removeprefix(IN_FILE).split(".")
    key, bracket, index = key.partition("[")
    return f"effects.{effect}.{key_in_file(effect, key, quantities)}{bracket}{index}"


def of_machine(name: str) -> bool:
    """Tell whether a fitted parameter is one of the machine file's own numbers."""
    return not (name.startswith("effects.") or belongs_to_recording(name))


def _lag(problem: Problem, i: int, signal: str) -> float:
    """Return how late a signal of an observation is behind its repeats, s."""
    apart = (each for each in problem.repeats if each.apart and i in each.members)
    lags = (each.lag_s[each.members.index(i)] for each in apart if signal in each.signals)
    return next(lags, 0.0)


def _in_file_terms(name: str, e: Estimate) -> Interval:
    """Return an interval as the machine file states its number; of a direction that of its angle."""
    _, effect, key = name.split(".")
    shape = CATALOGUE[effect].by_name.get(key.partition("[")[0])
    if shape is None or shape.size == "direction":
        return Interval(e.value, e.low, e.high)
    value, *ends = (file_value(shape, x, of_three=True) for x in (e.value, e.low, e.high))
    return Interval(value, min(ends), max(ends))


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(x) for x in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value
