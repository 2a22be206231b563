"""A check from captures to sentences: the order of the work on one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.check.compare import FIRST, SAME, UNKNOWN, Comparison, Verdict, compare, pairs_of, share_apart, verdict
from ffcomp.check.history import Check, plan_hash
from ffcomp.check.parts import Signatures, fitted
from ffcomp.check.signals import SensorSignal, signals_of
from ffcomp.record.plan import Plan
from ffcomp.record.result import JoinResult
from models.machine import Machine


@dataclass(frozen=True)
class Size:
    """How one experiment, or all, differ: shares of the signal, root mean squares."""

    name: str
    gap: float  # to the machine file
    noise: float
    difference: float | None  # to the check before


@dataclass(frozen=True, eq=False)
class CheckResult:
    """What a check has found."""

    check: Check  # for the history
    verdict: Verdict
    experiments: tuple[Size, ...]
    compared: Comparison | None
    compared_with: str | None  # date
    since_first: Verdict | None  # where it differs from the verdict
    first_date: str | None
    known: bool  # the very captures are in the history already
    notes: tuple[str, ...]

    def to_dict(self, machine: str, history: Path) -> dict[str, Any]:
        """Return the JSON object ffcomp-check/1."""
        comparison, since = self.compared, self.since_first
        turned = comparison.turned if comparison else None
        return {
            "schema": "ffcomp-check/1",
            "machine": {"name": machine, "sha256": self.check.machine_sha256},
            "date": self.check.date,
            "finding": self.verdict.finding,
            "said": self.verdict.message,
            "compared_with": self.compared_with,
            "gap": self.check.gap,
            "noise": self.check.noise,
            "difference": self.check.difference,
            "times_noise": comparison.times if comparison else None,
            "named": [
                {
                    "part": each.part.name,
                    "change": each.value,
                    "sd": each.sd,
                    "unit": each.part.unit,
                    "explains": min(each.share, 1.0),
                    "said": each.part.words(each.value),
                }
                for each in self.verdict.named
            ],
            "sensor_turned_deg": turned.degrees if turned else None,
            "sensor_gain": turned.gain if turned else None,
            "axes_map": self.check.axes_map,
            "since_first": {
                "date": self.first_date if since else None,
                "finding": since.finding if since else None,
                "said": since.message if since else None,
            },
            "experiments": [
                {"name": each.name, "gap": each.gap, "noise": each.noise, "difference": each.difference}
                for each in self.experiments
            ],
            "history": str(history),
            "added": not self.known,
            "notes": list(self.notes),
        }


def check_result(joined: JoinResult, plan: Plan, machine: Machine, history: Sequence[Check], date: str) -> CheckResult:
    """Compare what was joined with the machine file and with the history."""
    signals = signals_of(joined.joined, plan)
    moves = plan_hash(plan)
    comparable = [each for each in history if each.plan == moves and each.signals]
    known = [each for each in comparable if each.is_same_recording(signals)]
    earlier = comparable[: comparable.index(known[0])] if known else comparable
    names = {each.name for each in signals}
    signatures = Signatures(machine, [each for each in plan.experiments if each.name in names])
    axes = joined.joined[0].axes_map
    last, comparison = (earlier[-1] if earlier else None), None
    today, first_said = Verdict(FIRST, _first_words(history, moves)), None
    if last is not None and pairs_of(signals, last.signals):
        comparison = compare(pairs_of(signals, last.signals), fitted(signatures, last.signals_of(names)))
        today = verdict(comparison, _day(last.date), last.axes_map, axes)
        first_said = _since_first(signals, earlier, signatures, axes) if today.finding == SAME else None
    sizes = [_size(each, signatures, last) for each in signals]
    total = _total(sizes, signals)
    check = Check(
        date,
        moves,
        machine.sha256,
        axes,
        today.finding,
        today.message,
        total.gap,
        None if comparison is None else comparison.size,
        total.noise,
        tuple(signals),
    )
    notes = tuple(_notes(known, plan, names, last, machine))
    date_then, first = (last.date if comparison and last else None), (earlier[0].date if earlier else None)
    return CheckResult(check, today, tuple(sizes), comparison, date_then, first_said, first, bool(known), notes)


def against_file(result: CheckResult) -> str:
    """Say how far the machine file is from the printer."""
    return (
        f"Against the machine file: simulation and measurement differ by {result.check.gap:.1%} of the signals; noise "
        f"alone would leave {result.check.noise:.1%}."
    )


def to_do(result: CheckResult, captures: str, plan: str, machine: str) -> list[str]:
    """Say what comes next, where something does."""
    if result.verdict.finding in (UNKNOWN,) or (result.since_first and result.since_first.finding == UNKNOWN):
        return [f"To search for it: ffcomp diagnose {captures} --plan {plan} -m {machine}"]
    if result.verdict.named:
        return ["Repair that, or measure the machine file anew (ffcomp record plan, then ffcomp diagnose)."]
    return []


def _day(date: str) -> str:
    return date.replace("T", " ")


def _first_words(history: Sequence[Check], moves: str) -> str:
    if any(each.plan == moves for each in history):
        return "There is nothing to compare with: no earlier check has one of these experiments."
    if history:
        return "First check of these moves: those in the history were made with another plan."
    return "First check: there is nothing to compare with yet."


def _since_first(
    signals: Sequence[SensorSignal], earlier: Sequence[Check], signatures: Signatures, axes: str
) -> Verdict | None:
    """Compare with the first check: what creeps never differs from the last one."""
    first = earlier[0]
    pairs = pairs_of(signals, first.signals)
    if len(earlier) < 2 or not pairs:
        return None
    names = {each.name for each in signals}
    since = verdict(compare(pairs, fitted(signatures, first.signals_of(names))), _day(first.date), first.axes_map, axes)
    return since if since.finding != SAME else None


def _size(signal: SensorSignal, signatures: Signatures, last: Check | None) -> Size:
    noise = float(np.sqrt(np.mean(signal.noise**2))) / signal.size
    then = [each for each in last.signals if each.name == signal.name] if last else []
    difference = share_apart(signal, then[0].acceleration) if then else None
    return Size(signal.name, share_apart(signal, signatures.expected[signal.name]), noise, difference)


def _total(sizes: Sequence[Size], signals: Sequence[SensorSignal]) -> Size:
    weights = np.array([each.size**2 for each in signals]) / sum(each.size**2 for each in signals)
    gap, noise = (
        float(np.sqrt(weights @ np.array([getattr(each, key) for each in sizes]) ** 2)) for key in ("gap", "noise")
    )
    return Size("all", gap, noise, None)


def _notes(known: Sequence[Check], plan: Plan, names: set[str], last: Check | None, machine: Machine) -> list[str]:
    notes = []
    if known:
        notes.append(f"These captures are in the history already, of {_day(known[0].date)}; it was not changed.")
    missing = [each.name for each in plan.experiments if each.name not in names]
    if missing:
        notes.append(f"Without {', '.join(missing)}, of which no capture could be used.")
    if last is not None and last.machine_sha256 != machine.sha256:
        notes.append("The machine file has changed since; the comparison is of motion with motion all the same.")
    return notes
