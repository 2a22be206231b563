"""Compare two checks: whether the difference is noise, and if not, which one part explains it.

Every part is fitted by itself, first along its signature; the best ones are simulated again at the size that was found,
until that does not change: large changes are not proportional.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.check.parts import Part, Signatures
from ffcomp.check.signals import RATE_HZ, SensorSignal, Weighed, weighed
from models.arrays import FloatArray

AS_NOISE = 1.25  # times the noise: nothing has changed
TRIED_AGAIN, TIMES = 5, 5  # best parts, and how often
WORTHWHILE = 0.1  # of what the best part explains along its signature
CONVERGED = 2e-3  # of the size


@dataclass(frozen=True)
class Explanation:
    """One part, fitted to the difference."""

    part: Part
    value: float  # of the part's unit
    sd: float
    share: float  # of the difference that is not noise


@dataclass(frozen=True)
class Turned:
    """A sensor that is turned about the vertical, or reads more; fitted to the difference."""

    degrees: float
    gain: float  # relative change
    share: float


@dataclass(frozen=True)
class Comparison:
    """What differs between two checks."""

    size: float  # of the difference, as a share of the signal
    noise: float  # what noise alone would leave, as a share of the signal
    times: float  # the weighed difference, in times the noise
    rows: float  # that are independent
    explanations: tuple[Explanation, ...]  # the best first
    turned: Turned


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


def compare(pairs: Sequence[tuple[SensorSignal, SensorSignal]], around: Signatures) -> Comparison:
    """Compare two checks; the signatures are those around the earlier one."""
    problem = weighed(pairs)
    left = problem.fit([]).left
    changed = max(left - problem.rows, 1e-9 * left)
    explanations = [_along(problem, around, part, left, changed) for part in around.of]
    explanations.sort(key=lambda each: -each.share)
    if left > AS_NOISE**2 * problem.rows:
        tried = [each for each in explanations[:TRIED_AGAIN] if each.share > WORTHWHILE * explanations[0].share]
        explanations[: len(tried)] = _again(problem, around, tried, left, changed)
    signal = np.sqrt(np.mean([felt.size**2 for felt, _ in pairs]))
    apart = np.sqrt(np.mean([(a.size * share_apart(a, b.acceleration)) ** 2 for a, b in pairs]))
    noise = np.sqrt(np.mean([np.mean(a.noise**2 + b.noise**2) for a, b in pairs]))
    return Comparison(
        size=float(apart / signal),
        noise=float(noise / signal),
        times=float(np.sqrt(left / problem.rows)),
        rows=problem.rows,
        explanations=tuple(sorted(explanations, key=lambda each: -each.share)),
        turned=_turned(problem, pairs, left, changed),
    )


def _along(problem: Weighed, around: Signatures, part: Part, left: float, changed: float) -> Explanation:
    fit = problem.fit([problem.column(around.of[part])])
    value = float(np.clip(fit.values[0], part.lowest, part.highest))
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
            sizes[part] = float(np.clip(sizes[part] + step.values[0], part.lowest, part.highest))
        sizes = {part: size for part, size in sizes.items() if abs(size - before[part]) > CONVERGED * abs(size)}
        if not sizes:
            break
    return list(best.values())


def _turned(
    problem: Weighed, pairs: Sequence[tuple[SensorSignal, SensorSignal]], left: float, changed: float
) -> Turned:
    gain = {then.name: then.acceleration for _, then in pairs}
    turn = {name: np.column_stack([felt[:, 1], -felt[:, 0], 0.0 * felt[:, 2]]) for name, felt in gain.items()}
    fit = problem.fit([problem.column(turn), problem.column(gain)])
    return Turned(float(np.rad2deg(fit.values[0])), float(fit.values[1]), (left - fit.left) / changed)


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


def verdict(comparison: Comparison, last: str, axes_then: str, axes_now: str) -> Verdict:
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


def _differs(comparison: Comparison) -> str:
    return f"it differs by {comparison.size:.1%} of the signal, and noise would by {comparison.noise:.1%}"


def _quiet(comparison: Comparison, last: str) -> Verdict:
    """Judge a difference that looks like noise."""
    hidden = [each for each in comparison.explanations if each.part.worth is not None]
    loud = [each for each in hidden if abs(each.value) + 3.0 * each.sd > (each.part.worth or 0.0)]
    sure = [each for each in loud if abs(each.value) > SURE * each.sd]
    if comparison.noise > LOUD or loud:
        hint = f" Perhaps {sure[0].part.words(sure[0].value)}." if sure else ""
        return Verdict(
            CANNOT_TELL,
            f"Cannot tell whether the printer moves as on {last}: noise is {comparison.noise:.0%} of the signal.{hint} "
            "Tighten the accelerometer, stop fans and what else shakes, and check again.",
        )
    return Verdict(SAME, f"As on {last}: {_differs(comparison)}.")


def _sensor(comparison: Comparison) -> str | None:
    turned = comparison.turned
    others = max((each.share for each in comparison.explanations), default=0.0)
    if turned.share < EXPLAINED or turned.share <= others:
        return None
    if abs(turned.degrees) > TURNED_DEG and abs(turned.gain) <= GAINED:
        return (
            f"The accelerometer is turned by {abs(turned.degrees):.0f}° about the vertical since then: that explains "
            f"{min(turned.share, 1.0):.0%} of the change. Fasten it as it was, and check again."
        )
    if abs(turned.gain) > GAINED:
        more = "more" if turned.gain > 0 else "less"
        return (
            f"The accelerometer reads {abs(turned.gain):.0%} {more} of the same motion: that explains "
            f"{min(turned.share, 1.0):.0%} of the change. It is another one, or its range was set anew; the next check "
            "will be compared with this one."
        )
    return None


def _explained(comparison: Comparison, last: str) -> Verdict:
    """Name the part that explains the change, or the parts that do so equally well."""
    changed = f"The printer has changed since {last}: {_differs(comparison)}."
    best = comparison.explanations[0] if comparison.explanations else None
    if best is None or best.share < EXPLAINED:
        return Verdict(UNKNOWN, f"{changed} No single part explains it, so it cannot be told here what changed.")
    # of a change that noise half hides, the shares themselves are uncertain
    unsure = max(LEAST_LEFT, 3.0 * float(np.sqrt(2.0 / comparison.rows)) / (comparison.times**2 - 1.0))
    left = max(1.0 - best.share, unsure)
    alike = [
        each for each in comparison.explanations[1:] if each.share >= EXPLAINED and 1.0 - each.share < APART * left
    ]
    named = (best, *alike)
    words = ", or ".join(each.part.words(each.value) for each in named)
    unlike = " These, and some of each, cannot be told apart here." if alike else ""
    return Verdict(
        CHANGED,
        f"{changed} {words[0].upper()}{words[1:]}: that explains {min(best.share, 1.0):.0%} of it.{unlike}",
        named,
    )
