"""Compare two checks: whether the difference is noise, and if not, which one part explains it.

Every part is fitted by itself, first along its signature; the best ones are simulated again at the size that was found,
until that does not change: large changes are not proportional.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ffcomp.check.history import Check, moves_hash
from ffcomp.check.parts import Part, Signatures, fitted
from ffcomp.check.signals import RATE_HZ, SensorSignal, Weighed, signals_of, weighed
from ffcomp.numerics.serialise import keys
from ffcomp.record.plan import Plan, plan_dict
from ffcomp.record.result import JoinResult
from ffcomp.result import Fact, Result
from models.arrays import FloatArray
from models.machine import Machine

AS_NOISE = 1.25  # times the noise: nothing has changed
TRIED_AGAIN, TIMES = 5, 5  # best parts, and how often
WORTHWHILE = 0.1  # of what the best part explains along its signature
CONVERGED = 2e-3  # of the size


@dataclass(frozen=True)
class Explanation:
    """One part, fitted to the difference."""

    json_keys: ClassVar = keys("sd", "explains", "said", part="part.name", change="value", unit="part.unit")

    part: Part
    value: float  # of the part's unit
    sd: float
    share: float  # of the difference that is not noise

    @property
    def explains(self) -> float:
        """The share of the difference, 0 to 1."""
        return min(self.share, 1.0)

    @property
    def said(self) -> str:
        """The change in words."""
        return self.part.words(self.value)


@dataclass(frozen=True)
class Difference:
    """What differs between two checks."""

    size: float  # of the difference, as a share of the signal
    noise: float  # what noise alone would leave, as a share of the signal
    times: float  # the weighed difference, in times the noise
    rows: float  # that are independent
    explanations: tuple[Explanation, ...]  # the best first
    turned_deg: float  # of the sensor about the vertical, if that and its gain were all that changed
    gain: float  # of the sensor, relative
    sensor_share: float  # of the difference, that both explain


def pairs_of(today: Sequence[SensorSignal], then: Sequence[SensorSignal]) -> list[tuple[SensorSignal, SensorSignal]]:
    """Pair the experiments that both checks have."""
    earlier = {each.name: each for each in then}
    return [(each, earlier[each.name]) for each in today if each.name in earlier]


def share_apart(felt: SensorSignal, other: FloatArray) -> float:
    """Return what differs from (n, 3) m/s² without a delay, as a share of the signal."""
    slope = np.gradient(felt.acceleration, 1.0 / RATE_HZ, axis=0)
    apart = felt.acceleration - other
    apart = apart - slope * (np.sum(slope * apart) / max(float(np.sum(slope**2)), 1e-300))
    return float(np.sqrt(np.mean(apart**2))) / felt.size


def compare(pairs: Sequence[tuple[SensorSignal, SensorSignal]], around: Signatures) -> Difference:
    """Compare two checks; the signatures are those around the earlier one."""
    problem = weighed(pairs)
    left = problem.fit([]).left
    changed = max(left - problem.rows, 1e-9 * left)
    explanations = [_along(problem, around, part, left, changed) for part in around.of]
    explanations.sort(key=lambda each: -each.share)
    if left > AS_NOISE**2 * problem.rows:
        tried = [each for each in explanations[:TRIED_AGAIN] if each.share > WORTHWHILE * explanations[0].share]
        explanations[: len(tried)] = _again(problem, around, tried, left, changed)
    sensor = problem.fit(_of_sensor(problem, pairs))
    signal = np.sqrt(np.mean([felt.size**2 for felt, _ in pairs]))
    apart = np.sqrt(np.mean([(a.size * share_apart(a, b.acceleration)) ** 2 for a, b in pairs]))
    noise = np.sqrt(np.mean([np.mean(a.noise**2 + b.noise**2) for a, b in pairs]))
    return Difference(
        size=float(apart / signal),
        noise=float(noise / signal),
        times=float(np.sqrt(left / problem.rows)),
        rows=problem.rows,
        explanations=tuple(sorted(explanations, key=lambda each: -each.share)),
        turned_deg=float(np.rad2deg(sensor.values[0])),
        gain=float(sensor.values[1]),
        sensor_share=(left - sensor.left) / changed,
    )


def _along(problem: Weighed, around: Signatures, part: Part, left: float, changed: float) -> Explanation:
    fit = problem.fit([problem.column(around.of[part])])
    value = float(np.clip(fit.values[0], part.range.lowest, part.range.highest))
    share = (left - fit.left) / changed if value == fit.values[0] else 0.0
    return Explanation(part, value, float(fit.sd[0]), share)


def _again(
    problem: Weighed, around: Signatures, explanations: Sequence[Explanation], left: float, changed: float
) -> list[Explanation]:
    """Fit some parts by Gauss and Newton, all of them simulated together."""
    sizes = {each.part: each.value for each in explanations}
    best = {each.part: Explanation(each.part, each.value, each.sd, 0.0) for each in explanations}
    for _ in range(TIMES):
        before = dict(sizes)
        for part, (change, slope) in around.at(sizes).items():
            there, column = problem.column(change), problem.column(slope)
            share = (left - problem.fit([], without=there).left) / changed
            step = problem.fit([column], without=there)
            if share > best[part].share:
                best[part] = Explanation(part, sizes[part], float(step.sd[0]), share)
            elif best[part].share > 0.0:  # beyond the best: half of the way back
                sizes[part] = 0.5 * (sizes[part] + best[part].value)
                continue
            sizes[part] = float(np.clip(sizes[part] + step.values[0], part.range.lowest, part.range.highest))
        sizes = {part: size for part, size in sizes.items() if abs(size - before[part]) > CONVERGED * abs(size)}
        if not sizes:
            break
    return list(best.values())


def _of_sensor(problem: Weighed, pairs: Sequence[tuple[SensorSignal, SensorSignal]]) -> list[FloatArray]:
    """Return what a sensor shows that is turned about the vertical, and one that reads more."""
    gain = {then.name: then.acceleration for _, then in pairs}
    turn = {name: np.column_stack([felt[:, 1], -felt[:, 0], 0.0 * felt[:, 2]]) for name, felt in gain.items()}
    return [problem.column(turn), problem.column(gain)]


EXPLAINED = 0.9  # of the change, by the part that is named
APART = 2.0  # times as much must be left by any other part
LEAST_LEFT = 0.01  # of the change: less is not to be relied on
SURE = 5.0  # standard deviations
TURNED_DEG, GAINED = 1.0, 0.02
LOUD = 0.1  # noise, as a share of the signal
SAME, CHANGED, UNKNOWN, SENSOR, CANNOT_TELL, FIRST = (
    "same",
    "changed",
    "unknown",
    "sensor",
    "cannot_tell",
    "first",
)


@dataclass(frozen=True)
class Verdict:
    """A finding and its sentence; the explanations that it rests on."""

    finding: str
    message: str
    named: tuple[Explanation, ...] = ()


def verdict(comparison: Difference, last: str, axes_then: str, axes_now: str) -> Verdict:
    """Say what two checks show, the earlier one of the date `last`."""
    turned = (
        ""
        if axes_then == axes_now
        else (
            f"The accelerometer was turned since {last}: the printer's axes were {axes_then} of its own, and are "
            f"{axes_now} now. It is turned back for the comparison. "
        )
    )
    if comparison.times <= AS_NOISE:
        quiet = _quiet(comparison, last)
        if turned and quiet.finding == SAME:
            return Verdict(SENSOR, turned + f"Otherwise the printer moves as on {last}.")
        return Verdict(quiet.finding, turned + quiet.message, quiet.named)
    moved = _sensor(comparison)
    if moved is not None:
        return Verdict(SENSOR, turned + moved)
    explained = _explained(comparison, last)
    return Verdict(explained.finding, turned + explained.message, explained.named)


def _differs(comparison: Difference) -> str:
    return f"it differs by {comparison.size:.1%} of the signal, and noise would by {comparison.noise:.1%}"


def _quiet(comparison: Difference, last: str) -> Verdict:
    """Judge a difference that looks like noise."""
    hidden = [each for each in comparison.explanations if each.part.worth is not None]
    loud = [each for each in hidden if abs(each.value) + 3.0 * each.sd > (each.part.worth or 0.0)]
    sure = [each for each in loud if abs(each.value) > SURE * each.sd]
    if comparison.noise > LOUD or loud:
        hint = f" Perhaps {sure[0].part.words(sure[0].value)}." if sure else ""
        return Verdict(
            CANNOT_TELL,
            f"Cannot tell whether the printer moves as on {last}: noise is {comparison.noise:.0%} of the signal."
            f"{hint} Tighten the accelerometer, stop fans and other sources of vibration, and check again.",
        )
    return Verdict(SAME, f"As on {last}: {_differs(comparison)}.")


def _sensor(comparison: Difference) -> str | None:
    turned, gain, share = abs(comparison.turned_deg), comparison.gain, comparison.sensor_share
    others = max((each.share for each in comparison.explanations), default=0.0)
    if share < EXPLAINED or share <= others:
        return None
    explains = f"that explains {min(share, 1.0):.0%} of the change."
    if turned > TURNED_DEG and abs(gain) <= GAINED:
        return (
            f"The accelerometer is turned by {turned:.0f}° about the vertical since then: {explains} Fasten it as it "
            "was, and check again."
        )
    if abs(gain) > GAINED:
        return (
            f"The accelerometer reads {abs(gain):.0%} {'more' if gain > 0 else 'less'} of the same motion: {explains} "
            "It is another one, or its range was changed; the next check will be compared with this one."
        )
    return None


def _explained(comparison: Difference, last: str) -> Verdict:
    """Name the part that explains the change, or the parts that do so equally well."""
    changed = f"The printer has changed since {last}: {_differs(comparison)}."
    best = comparison.explanations[0] if comparison.explanations else None
    if best is None or best.share < EXPLAINED:
        return Verdict(UNKNOWN, f"{changed} No single part explains it, so the check does not name one.")
    # of a change that noise half hides, the shares themselves are uncertain
    unsure = max(LEAST_LEFT, 3.0 * float(np.sqrt(2.0 / comparison.rows)) / (comparison.times**2 - 1.0))
    left = max(1.0 - best.share, unsure)
    alike = [
        each for each in comparison.explanations[1:] if each.share >= EXPLAINED and 1.0 - each.share < APART * left
    ]
    named = (best, *alike)
    words = ", or ".join(each.part.words(each.value) for each in named)
    unlike = " The check cannot separate these, or a mixture of them." if alike else ""
    return Verdict(
        CHANGED,
        f"{changed} {words[0].upper()}{words[1:]}: that explains {min(best.share, 1.0):.0%} of it.{unlike}",
        named,
    )


# ---- a check from captures to sentences: the order of the work -----------------------------------


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
        *("machine", "compared_with", "since_first", "first_date", "experiments", "history", "notes"),
        machine_sha256="check.machine_sha256",
        date="check.date",
        finding="verdict.finding",
        said="verdict.message",
        named="verdict.named",
        gap="check.gap",
        noise="check.noise",
        difference="check.difference",
        axes_map="check.axes_map",
        times_noise="compared.times",
        sensor_turned_deg="compared.turned_deg",
        sensor_gain="compared.gain",
        already_known="known",
    )

    check: Check  # for the history
    verdict: Verdict
    experiments: tuple[Size, ...]
    compared: Difference | None
    compared_with: str | None  # date
    since_first: Verdict | None  # where it differs from the verdict
    first_date: str | None
    known: bool  # the very captures are in the history already
    notes: tuple[str, ...]
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


def check_result(joined: JoinResult, plan: Plan, machine: Machine, history: Sequence[Check], date: str) -> CheckResult:
    """Compare what was joined with the machine file and with the history."""
    signals = signals_of(joined.joined, plan)
    moves = moves_hash(plan_dict(plan)["experiments"])
    comparable = [each for each in history if each.plan == moves and each.signals]
    known = [each for each in comparable if each.is_same_recording(signals)]
    earlier = comparable[: comparable.index(known[0])] if known else comparable
    names = {each.name for each in signals}
    signatures = Signatures(machine, [each for each in plan.experiments if each.name in names])
    axes = joined.joined[0].axes_map
    last, comparison = (earlier[-1] if earlier else None), None
    today, since_first = Verdict(FIRST, _first_words(history, moves)), None
    if last is not None and pairs_of(signals, last.signals):
        comparison = compare(pairs_of(signals, last.signals), fitted(signatures, last.signals_of(names)))
        today = verdict(comparison, _day(last.date), last.axes_map, axes)
        since_first = _since_first(signals, earlier, signatures, axes) if today.finding == SAME else None
    sizes = [_size(each, signatures, last) for each in signals]
    total = _total(sizes, signals)
    check = Check(
        date=date,
        plan=moves,
        machine_sha256=machine.sha256,
        axes_map=axes,
        finding=today.finding,
        message=today.message,
        gap=total.gap,
        difference=None if comparison is None else comparison.size,
        noise=total.noise,
        signals=tuple(signals),
    )
    date_then, first = (last.date if comparison and last else None), (earlier[0].date if earlier else None)
    return CheckResult(
        check=check,
        verdict=today,
        experiments=tuple(sizes),
        compared=comparison,
        compared_with=date_then,
        since_first=since_first,
        first_date=first,
        known=bool(known),
        notes=tuple(_notes(known, plan, names, last, machine)),
    )


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
        notes.append(f"Left out, because no capture of it could be used: {', '.join(missing)}.")
    if last is not None and last.machine_sha256 != machine.sha256:
        notes.append("The machine file has changed since; the comparison is of motion with motion all the same.")
    return notes
