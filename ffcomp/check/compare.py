"""A check from captures to sentences: whether the printer moves as last time, or which one change explains it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ffcomp.check.changes import (
    AS_NOISE,
    Difference,
    Explanation,
    SensorSignal,
    compare,
    earlier_machine,
    expected_signals,
    share_apart,
    signals_of,
)
from ffcomp.check.history import Check, moves_hash
from ffcomp.numerics.serialise import keys
from ffcomp.record.plan import Experiment, Plan, plan_dict
from ffcomp.record.result import JoinResult
from ffcomp.result import Fact, Result
from models.machine import Machine

EXPLAINED = 0.9  # of the change, by the part that is named
APART = 2.0  # times as much must be left by any other part
LEAST_LEFT = 0.01  # of the change: less is not to be relied on
TURNED_DEG, GAINED = 1.0, 0.02
LOUD = 0.1  # noise, as a share of the signal
SAME, CHANGED, UNKNOWN, SENSOR, CANNOT_TELL, FIRST = "same", "changed", "unknown", "sensor", "cannot_tell", "first"


@dataclass(frozen=True)
class Verdict:
    """A finding and its sentence; the explanations that it rests on."""

    finding: str
    message: str
    named: tuple[Explanation, ...] = ()


def verdict(found: Difference, then: Check, axes_now: str) -> Verdict:
    """Say what an earlier check and this one show."""
    last, turned = _day(then.date), ""
    if then.axes_map != axes_now:
        turned = (
            f"The accelerometer was turned since {last}: the printer's axes were {then.axes_map} of its own, and are "
            f"{axes_now} now. It is turned back for the comparison. "
        )
    differs = f"it differs by {found.size:.1%} of the signal, and noise would by {found.noise:.1%}"
    if found.times <= AS_NOISE:
        missed = [
            each for each in found.explanations if abs(each.value) + 3.0 * each.sd > (each.change.worth or np.inf)
        ]
        if found.noise > LOUD or missed:
            return Verdict(
                CANNOT_TELL,
                f"{turned}Cannot tell whether the printer moves as on {last}: noise is {found.noise:.0%} of the "
                "signal. Tighten the accelerometer, stop fans and other sources of vibration, and check again.",
            )
        if turned:
            return Verdict(SENSOR, f"{turned}Otherwise the printer moves as on {last}.")
        return Verdict(SAME, f"As on {last}: {differs}.")
    if moved := _sensor(found):
        return Verdict(SENSOR, turned + moved)
    changed = f"{turned}The printer has changed since {last}: {differs}."
    named = _named(found)
    if not named:
        return Verdict(UNKNOWN, f"{changed} No single part explains it, so the check does not name one.")
    words = ", or ".join(each.change.words(each.value) for each in named)
    unlike = " The check cannot separate these, or a mixture of them." if len(named) > 1 else ""
    explains = f"that explains {min(named[0].share, 1.0):.0%} of it."
    return Verdict(CHANGED, f"{changed} {words[0].upper()}{words[1:]}: {explains}{unlike}", named)


def _sensor(found: Difference) -> str:
    """Name the sensor's change where it explains the difference better than the printer; '' where not."""
    others = max((each.share for each in found.explanations), default=0.0)
    if found.sensor_share < max(EXPLAINED, others):
        return ""
    explains = f"that explains {min(found.sensor_share, 1.0):.0%} of the change."
    if abs(found.gain) > GAINED:
        return (
            f"The accelerometer reads {abs(found.gain):.0%} {'more' if found.gain > 0 else 'less'} of the same motion: "
            f"{explains} It is another one, or its range was changed; the next check will be compared with this one."
        )
    if abs(found.turned_deg) > TURNED_DEG:
        return (
            f"The accelerometer is turned by {abs(found.turned_deg):.0f}° about the vertical since then: {explains} "
            "Fasten it as it was, and check again."
        )
    return ""


def _named(found: Difference) -> tuple[Explanation, ...]:
    """Return the change that explains the difference, and those that do so equally well; none where none does."""
    if not found.explanations or found.explanations[0].share < EXPLAINED:
        return ()
    best, *others = found.explanations
    # of a change that noise half hides, the shares themselves are uncertain
    unsure = max(LEAST_LEFT, 3.0 * float(np.sqrt(2.0 / found.rows)) / (found.times**2 - 1.0))
    left = max(1.0 - best.share, unsure)
    return best, *(each for each in others if each.share >= EXPLAINED and 1.0 - each.share < APART * left)


def _day(date: str) -> str:
    return date.replace("T", " ")


# ---- the result ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Size:
    """How one experiment, or all, differ: shares of the signal, root mean squares."""

    name: str
    gap: float
    noise: float
    difference: float | None


@dataclass(frozen=True, eq=False, repr=False)
class CheckResult(Result):
    """What a check has found."""

    title = "Check of the printer"
    drawn_by: ClassVar = {"history": "ffcomp.report.check:checks_figure"}
    schema = "ffcomp-check/1"
    json_keys: ClassVar = keys(
        *("machine", "experiments", "history", "notes"),
        machine_sha256="check.machine_sha256",
        date="check.date",
        finding="verdict.finding",
        said="verdict.message",
        named="verdict.named",
        compared_with="since.date",
        first_date="first.date",
        gap="check.gap",
        noise="check.noise",
        difference="check.difference",
        axes_map="check.axes_map",
        times_noise="compared.times",
        sensor_turned_deg="compared.turned_deg",
        sensor_gain="compared.gain",
        already_known="known",
        since_first="since_first.message",
        since_first_finding="since_first.finding",
    )

    check: Check  # for the history
    verdict: Verdict
    experiments: Sequence[Size]
    compared: Difference | None
    since: Check | None  # the check that this one is compared with
    since_first: Verdict | None  # where it differs from the verdict
    first: Check | None
    known: bool  # the very captures are in the history already
    notes: Sequence[str]
    machine: str = ""  # its name
    history: Path | None = None  # the file of earlier checks
    checks: Sequence[Check] = ()  # of the history, with this one
    diagnose: str = ""  # the command that searches for what changed

    @property
    def headline(self) -> str:
        """Whether the printer moves as last time, and if not, what changed."""
        since = "" if self.since_first is None else f" But since the first check: {self.since_first.message}"
        return f"{self.verdict.message}{since}"

    @property
    def facts(self) -> list[Fact]:
        """How far each experiment is from the machine file and from the last check."""
        facts = [("Machine file", f"{self.check.gap:.1%} off; noise alone {self.check.noise:.1%}")]
        for each in self.experiments:
            then = "" if each.difference is None else f", {each.difference:.1%} from the last check"
            facts.append((each.name, f"{each.gap:.1%} from the machine file{then}; noise {each.noise:.1%}"))
        return facts if self.known or self.history is None else [*facts, ("Added to", str(self.history))]

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences on the limits of the comparison."""
        return self.notes

    @property
    def next_steps(self) -> list[str]:
        """The next step, if there is one."""
        findings = [each.finding for each in (self.verdict, self.since_first) if each is not None]
        if UNKNOWN in findings:
            return [f"To search for it: {self.diagnose}"]
        if self.verdict.named:
            return ["Repair that, or measure the printer again (ffcomp record plan, then ffcomp diagnose)."]
        return []


# ---- the order of the work -----------------------------------------------------------------------


def check_result(joined: JoinResult, plan: Plan, machine: Machine, history: Sequence[Check], date: str) -> CheckResult:
    """Compare joined captures with the machine file and with the history."""
    signals, axes = signals_of(joined.joined, plan), joined.joined[0].axes_map
    moves = moves_hash(plan_dict(plan)["experiments"])
    comparable = [each for each in history if each.plan == moves and each.signals]
    known = [each for each in comparable if each.is_same_recording(signals)]
    earlier = comparable[: comparable.index(known[0])] if known else comparable
    experiments = {each.name: each for each in plan.experiments}
    today, compared = Verdict(FIRST, _first_words(history, moves)), None
    last = next((each for each in earlier[-1:] if pairs_of(signals, each)), None)
    if last is not None:
        compared = _compared(signals, last, machine, experiments)
        today = verdict(compared, last, axes)
    since_first = None
    if today.finding == SAME and len(earlier) > 1 and pairs_of(signals, earlier[0]):  # what creeps never differs
        since = verdict(_compared(signals, earlier[0], machine, experiments), earlier[0], axes)
        since_first = since if since.finding != SAME else None
    sizes = _sizes(signals, last, machine, experiments)
    weights = np.array([each.size**2 for each in signals]) / sum(each.size**2 for each in signals)
    gap, noise = (
        float(np.sqrt(weights @ np.square(each))) for each in ([s.gap for s in sizes], [s.noise for s in sizes])
    )
    check = Check(
        date=date,
        plan=moves,
        machine_sha256=machine.sha256,
        axes_map=axes,
        finding=today.finding,
        said=today.message,
        gap=gap,
        difference=None if compared is None else compared.size,
        noise=noise,
        signals=tuple(signals),
    )
    missing = [name for name in experiments if all(each.name != name for each in signals)]
    notes = []
    if known:
        notes.append(f"These captures are in the history already, of {_day(known[0].date)}; it was not changed.")
    if missing:
        notes.append(f"Left out, because no capture of it could be used: {', '.join(missing)}.")
    if earlier and earlier[-1].machine_sha256 != machine.sha256:
        notes.append("The machine file has changed since; the comparison is of motion with motion all the same.")
    first = earlier[0] if earlier else None
    return CheckResult(check, today, sizes, compared, last, since_first, first, bool(known), notes)


def pairs_of(today: Sequence[SensorSignal], then: Check) -> list[tuple[SensorSignal, SensorSignal]]:
    """Pair the experiments that both checks have."""
    earlier = {each.name: each for each in then.signals}
    return [(each, earlier[each.name]) for each in today if each.name in earlier]


def _compared(
    today: Sequence[SensorSignal], then: Check, machine: Machine, experiments: Mapping[str, Experiment]
) -> Difference:
    pairs = pairs_of(today, then)
    shared = [experiments[each.name] for each, _ in pairs]
    return compare(earlier_machine(machine, shared, [each for _, each in pairs]), shared, pairs)


def _first_words(history: Sequence[Check], moves: str) -> str:
    if any(each.plan == moves for each in history):
        return "There is nothing to compare with: no earlier check has one of these experiments."
    if history:
        return "First check of these moves: those in the history were made with another plan."
    return "First check: there is nothing to compare with yet."


def _sizes(
    signals: Sequence[SensorSignal], last: Check | None, machine: Machine, experiments: Mapping[str, Experiment]
) -> list[Size]:
    then = {each.name: share_apart(each, old.acceleration) for each, old in (pairs_of(signals, last) if last else [])}
    expected = expected_signals([machine], [experiments[each.name] for each in signals])
    return [
        Size(s.name, share_apart(s, felt[0]), float(np.sqrt(np.mean(s.noise**2))) / s.size, then.get(s.name))
        for s, felt in zip(signals, expected, strict=True)
    ]
