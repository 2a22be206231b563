"""Compare two checks: whether the difference is noise, and if not, which one part explains it.

Every part is fitted by itself, first along its signature; the best ones are simulated again at the size that was found,
until that does not change: large changes are not proportional.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.check.felt import RATE_HZ, Felt
from ffcomp.check.parts import Part
from ffcomp.check.signatures import Signatures
from ffcomp.check.weighed import Weighed, weighed
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


def pairs_of(today: Sequence[Felt], then: Sequence[Felt]) -> list[tuple[Felt, Felt]]:
    """Pair the experiments that both checks have."""
    earlier = {each.name: each for each in then}
    return [(each, earlier[each.name]) for each in today if each.name in earlier]


def share_apart(felt: Felt, other: FloatArray) -> float:
    """Return what differs from (n, 3) m/s² without a delay, as a share of the signal."""
    slope = np.gradient(felt.acceleration, 1.0 / RATE_HZ, axis=0)
    apart = felt.acceleration - other
    apart = apart - slope * (np.sum(slope * apart) / max(float(np.sum(slope**2)), 1e-300))
    return float(np.sqrt(np.mean(apart**2))) / felt.size


def compare(pairs: Sequence[tuple[Felt, Felt]], around: Signatures) -> Comparison:
    """Compare two checks; the signatures are those around the earlier one."""
    problem = weighed(pairs)
    left = problem.fit([]).left
    changed = max(left - problem.rows, 1e-9 * left)
    found = [_along(problem, around, part, left, changed) for part in around.of]
    found.sort(key=lambda each: -each.share)
    if left > AS_NOISE**2 * problem.rows:
        tried = [each for each in found[:TRIED_AGAIN] if each.share > WORTHWHILE * found[0].share]
        found[: len(tried)] = _again(problem, around, tried, left, changed)
    signal = np.sqrt(np.mean([felt.size**2 for felt, _ in pairs]))
    apart = np.sqrt(np.mean([(a.size * share_apart(a, b.acceleration)) ** 2 for a, b in pairs]))
    noise = np.sqrt(np.mean([np.mean(a.noise**2 + b.noise**2) for a, b in pairs]))
    return Comparison(
        size=float(apart / signal),
        noise=float(noise / signal),
        times=float(np.sqrt(left / problem.rows)),
        rows=problem.rows,
        explanations=tuple(sorted(found, key=lambda each: -each.share)),
        turned=_turned(problem, pairs, left, changed),
    )


def _along(problem: Weighed, around: Signatures, part: Part, left: float, changed: float) -> Explanation:
    fit = problem.fit([problem.column(around.of[part])])
    value = float(np.clip(fit.values[0], part.lowest, part.highest))
    share = (left - fit.left) / changed if value == fit.values[0] else 0.0
    return Explanation(part, value, float(fit.sd[0]), share)


def _again(
    problem: Weighed, around: Signatures, found: Sequence[Explanation], left: float, changed: float
) -> list[Explanation]:
    """Fit some parts by Gauss and Newton, all of them simulated together."""
    sizes = {each.part: each.value for each in found}
    best = {each.part: Explanation(each.part, each.value, each.sd, 0.0) for each in found}
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


def _turned(problem: Weighed, pairs: Sequence[tuple[Felt, Felt]], left: float, changed: float) -> Turned:
    gain = {then.name: then.acceleration for _, then in pairs}
    turn = {name: np.column_stack([felt[:, 1], -felt[:, 0], 0.0 * felt[:, 2]]) for name, felt in gain.items()}
    fit = problem.fit([problem.column(turn), problem.column(gain)])
    return Turned(float(np.rad2deg(fit.values[0])), float(fit.values[1]), (left - fit.left) / changed)
