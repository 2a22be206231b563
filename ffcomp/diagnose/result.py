"""A diagnosis in the terms of the machine file: effects with intervals, retuned parameters, residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.diagnose.diagnosis import Diagnosis
from ffcomp.diagnose.fit import Fit
from ffcomp.diagnose.printer_problem import WHOLE, effect_tables
from ffcomp.diagnose.problem import TOWERS, Problem
from ffcomp.diagnose.recording_clocks import belongs_to_recording, delay_of
from ffcomp.diagnose.residuals import ResidualSize, locate_residual
from ffcomp.diagnose.separation import Separation
from ffcomp.identify.uncertainty import Estimate
from models.effects.catalogue import CATALOGUE, key_in_file
from models.file import updated_text

DISCREPANCY, CLOSED = 0.1, 0.5  # of the noise, to be one; of the discrepancy, to be closed by retuning
SAID_S = 1e-4  # from which it is said that a file lies late
OFF = 0.05  # of a number of the file, from which it is said that it may be off by so much
ONE_PLACE, FILE_OFF = 0.9, 0.5  # the most an effect is sure that was tested at one place, or that wrong numbers mimic
ELSEWHERE = ("places", "windows")  # of time, where a machine has one place only
BEYOND = 3.0  # standard deviations: by chance one of fifteen numbers is so far off in one machine of 25
MOVED = 0.1  # standard deviations of its uncertainty from which a parameter counts as retuned


@dataclass(frozen=True, eq=False)
class DiagnosisResult:
    """The contents of the answer and of the better machine file."""

    verdict: str
    effects: Mapping[str, Mapping[str, Any]]  # of the best hypothesis, as tables of a machine file
    intervals: Mapping[str, Estimate]  # effects.name.key -> in the machine file's terms
    retuned: Mapping[str, tuple[float, float]]  # from, to
    confounded_with: Sequence[tuple[str, str]]  # effect, how to tell them apart
    before: ResidualSize
    after: ResidualSize
    held_out: tuple[float, float]  # nrms before and after, at positions that were left out of the fit
    gained: float  # −2 ln Z against retuning alone
    confidence: Mapping[str, float]  # of each effect against the best that was tried without it
    rejections: Sequence[str]
    invisible: Sequence[str]  # effects of which the recordings could not show a usual size
    finding: str = ""  # the verdict more closely, see diagnosis.FINDINGS
    fault: str = ""  # of the recordings: a sentence
    late_s: Mapping[str, float] = field(default_factory=dict)  # files that lie off their command by more than 0.1 ms
    left_out: str = "places"  # what was left out of the fit in turn: places, experiments, windows, or nothing ("")
    unproven: Sequence[str] = ()  # places or experiments where it is not explained
    file_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # numbers that would explain as much
    per_kilogram: bool = False  # forces are, on axes of unknown mass
    carriages: tuple[str, ...] = TOWERS  # what a value for each is of, and
    belts: tuple[str, ...] = TOWERS  # of belts and their motors
    separations: Sequence[Separation] = ()  # from what fits as well: see `problems.separated`
    cut_short: bool = False  # the search ended at its budget
    noise_guessed: bool = False  # no motion was repeated
    beyond: Mapping[str, float] = field(default_factory=dict)  # numbers retuned by so many of their uncertainties

    @property
    def mends(self) -> bool:
        """Tell whether a better file exists: with effects, or with retuned parameters that suffice also elsewhere."""
        if self.verdict != "none":
            return self.verdict == "effects"
        if self.late_s or not self.left_out:
            return False
        noise = self.before.noise_nrms
        gap, left = self.before.nrms - noise, self.after.nrms - noise
        gap_elsewhere, left_elsewhere = (x - noise for x in self.held_out)
        return gap > DISCREPANCY * noise and left < CLOSED * gap and left_elsewhere < CLOSED * gap_elsewhere

    @property
    def explained(self) -> float:
        """Share of the discrepancy above the noise that is explained, in power."""
        return explained(self.before.nrms, self.after.nrms, self.before.noise_nrms)

    @property
    def explained_elsewhere(self) -> float:
        """The same where it was left out of the fit."""
        return explained(*self.held_out, self.before.noise_nrms)

    def parameters(self, effect: str) -> dict[str, dict[str, Any]]:
        """Return value, low and high of one effect by the machine file's keys; lists where the file has lists."""
        prefix, found = f"effects.{effect}.", dict[str, list[Estimate]]()
        for name, e in self.intervals.items():
            if name.startswith(prefix):
                found.setdefault(name.removeprefix(prefix).partition("[")[0], []).append(e)
        return {
            key_in_file(effect, key, self.per_kilogram): _file_values(effect, key, own, self.effects[effect][key])
            for key, own in found.items()
            if key != WHOLE
        }


def explained(before: float, after: float, noise: float) -> float:
    """Return the explained share of a discrepancy above the noise, in power; nrms all three."""
    gap, left = before**2 - noise**2, after**2 - noise**2
    return 1 - max(left, 0.0) / gap if gap > 0 else 0.0


def result_of(problem: Problem, found: Diagnosis) -> DiagnosisResult:
    """Translate a diagnosis; the best hypothesis is reported even if it was rejected."""
    fitted = found.final
    tables = effect_tables(fitted.values) if found.best is not None else {}
    retuned = {
        n.name: (n.start, problem.stated(fitted.values, n.name))
        for n, z in zip(fitted.parameters, fitted.z, strict=True)
        if of_machine(n.name) and abs(z) > MOVED
    }
    noise = locate_residual(found.estimation.whiten, found.noise, problem.simulate({})).total
    after = locate_residual(found.estimation.whiten, found.noise, problem.simulate(fitted.values)).total
    return DiagnosisResult(
        found.verdict,
        tables,
        {name: _in_file_terms(name, e) for name, e in found.intervals.items() if name.startswith("effects.")},
        retuned,
        [(name, _apart(tables, name)) for name in found.confounded],
        noise,
        after,
        _held_out(found, noise.noise_nrms),
        found.base.evidence - fitted.evidence,
        {name: _confidence(found, name) for name in tables},
        found.rejections,
        found.invisible,
        found.finding,
        "" if found.fault is None else found.fault.sentence(),
        _late(problem, found),
        _left_out(found),
        [one.label for one in found.unproven],
        _file_off(found),
        problem.per_kilogram,
        problem.carriages,
        problem.belts,
        cut_short=found.cut_short,
        noise_guessed=not found.noise.from_repeats,
        beyond=_beyond(fitted),
    )


def _left_out(found: Diagnosis) -> str:
    if not found.held_out:
        return "" if found.best is not None or found.verdict == "none" else "places"
    if len(found.held_out[0].position) == 1:
        return "windows"
    return "experiments" if found.held_out[0].experiment else "places"


def _late(problem: Problem, found: Diagnosis) -> dict[str, float]:
    """Return how late files lie: what repeats say of each other, and what the fit says of them together."""
    values = found.final.values if found.best is not None else found.base.values
    late = {}
    for i, o in enumerate(problem.observations):
        offs = [_lag(problem, i, o.signals[own[0]]) + delay_of(values, o, clock) for clock, own in o.by_clock.items()]
        off = max(offs, key=abs)
        if abs(off) > SAID_S:
            late[Path(o.name).name] = off
    return late


def _lag(problem: Problem, i: int, signal: str) -> float:
    """Return how late a signal of an observation is behind its repeats, s."""
    own = (each for each in problem.repeats if each.apart and i in each.members)
    lags = (each.lag_s[each.members.index(i)] for each in own if signal in each.signals or not each.signals)
    return next(lags, 0.0)


def _file_off(found: Diagnosis) -> dict[str, tuple[float, float]]:
    """Return the machine's numbers that would have to be wrong instead, those that move most first."""
    if found.file_off is None:
        return {}
    fitted = found.file_off
    moved = sorted(zip(fitted.parameters, fitted.z, strict=True), key=lambda each: -abs(each[1]))
    own = [(n, fitted.values[n.name]) for n, _ in moved if of_machine(n.name) and n.start]
    return {n.name: (n.start, x) for n, x in own if abs(x / n.start - 1) > OFF}


def of_machine(name: str) -> bool:
    """Tell whether a fitted parameter is one of the machine file's own numbers."""
    return not (name.startswith("effects.") or belongs_to_recording(name))


def _confidence(found: Diagnosis, effect: str) -> float:
    """Compute the probability against the best hypothesis without the effect, both equally likely beforehand."""
    if found.best is None:
        return 0.0
    fitted = found.best.fit
    behind = [found.behind(h) for h in found.tried if effect not in h.names]
    nearest = min([*behind, found.base.evidence - fitted.evidence])
    sure = float(1 / (1 + np.exp(-np.clip(nearest / fitted.misfit / 2, -50, 50))))
    return min(sure, 1.0 if _left_out(found) in ELSEWHERE else ONE_PLACE, 1.0 if found.file_off is None else FILE_OFF)


def _beyond(fitted: Fit) -> dict[str, float]:
    """Return the file's own numbers that moved beyond what it says of them, the furthest first."""
    far = {n.name: abs(float(z)) for n, z in zip(fitted.parameters, fitted.z, strict=True) if of_machine(n.name)}
    return {name: z for name, z in sorted(far.items(), key=lambda each: -each[1]) if z > BEYOND}


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


def _file_values(effect: str, key: str, own: Sequence[Estimate], table: Any) -> dict[str, Any]:
    """Return value, low and high of one key.

    Parameters
    ----------
    table : the key's value in the machine file.
    """
    if CATALOGUE[effect].parameter(key).size == "direction":
        ends = [[round(math.cos(x), 6), round(math.sin(x), 6)] for x in (own[0].low, own[0].high)]
        low, high = (table, table) if isinstance(table, str) else ends
        return {"value": table, "low": low, "high": high}
    each = {what: [float(getattr(e, what)) for e in own] for what in ("value", "low", "high")}
    if isinstance(table, list):  # actuators that rested in all recordings have no estimate
        each = {what: [*values, *table[len(values) :]] for what, values in each.items()}
    return {what: values if len(values) > 1 else values[0] for what, values in each.items()}


def _apart(tables: Mapping[str, Any], other: str) -> str:
    """Say how to tell another effect from the named ones."""
    for name in tables:
        sentence = CATALOGUE[name].confounded_with.get(other) or CATALOGUE[other].confounded_with.get(name)
        if sentence:
            return sentence
    return "Runs at more places and at several speeds."


def _held_out(found: Diagnosis, noise: float) -> tuple[float, float]:
    """Compute nrms over all positions, each left out of the fit in turn: with the file as it is, and with the fit."""
    if not found.held_out:
        return noise, noise
    filed, after, signals = np.sum([p.power for p in found.held_out], axis=0)
    return float(np.sqrt(filed / signals)), float(np.sqrt(after / signals))


def better_file(source: Path, name: str, found: DiagnosisResult, data: Sequence[str], when: str) -> str:
    """Write the machine file with the named effects, the retuned parameters and their provenance; comments survive."""
    values: dict[str, Any] = {key: float(f"{to:.6g}") for key, (_, to) in found.retuned.items()}
    for effect, table in found.effects.items():
        if not table:
            values[f"effects.{effect}"] = {}
        values |= {
            f"effects.{effect}.{key_in_file(effect, key, found.per_kilogram)}": _rounded(value)
            for key, value in table.items()
        }
    entry = {
        "date": when,
        "started_from": source.stem,
        "data": list(data),
        "intervals_90_percent": {n: f"{e.low:.4g} to {e.high:.4g}" for n, e in found.intervals.items()},
        "gap_nrms_before": float(f"{found.before.nrms:.4g}"),
        "gap_nrms_after": float(f"{found.after.nrms:.4g}"),
        "gap_nrms_noise": float(f"{found.before.noise_nrms:.4g}"),
        "held_out_nrms_before_after": [float(f"{x:.4g}") for x in found.held_out],
    }
    return updated_text(source, values, name=name, provenance={"diagnosed": entry})


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(x) for x in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value
