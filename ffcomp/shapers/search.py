"""Search the best shaper, or any positive settings, for one motion: scans, then ever finer steps about the best."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.shapers.pulses import DAMPING_RATIO, Shaper
from ffcomp.shapers.smooth import SHAPERS
from models.arrays import FloatArray

_COARSE = 1.08  # ratio of neighbouring frequencies in the scans

ShaperCost = Callable[[Shaper, Shaper], float]  # of an x and a y shaper


@dataclass(frozen=True, slots=True)
class Fixed:
    """Shapers that stay the same everywhere, and their cost."""

    x: Shaper
    y: Shaper
    frequency_hz: tuple[float, float]  # of x and y
    damping_ratio: float
    cost: float


def best_fixed(
    kind: str,
    cost: ShaperCost,
    range_hz: tuple[float, float] = (20.0, 120.0),
    damping_ratios: Sequence[float] = (DAMPING_RATIO,),
    tolerance: float = 0.005,
    scanned: ShaperCost | None = None,
) -> Fixed:
    """Find the fixed shapers of one kind with the least cost.

    One frequency for both axes is scanned with every damping ratio, then x alone, then y alone: some 80 costs for one
    damping ratio, and 20 for the steps.

    Parameters
    ----------
    kind : a name in `SHAPERS`
    cost : best on the very motion the shapers are to serve: no calibration can do better
    range_hz : lowest and highest frequency of the scans
    damping_ratios : the scans' best one is kept
    tolerance : relative step of the frequencies at which the search ends
    scanned : a cheaper cost for the scans; None: the same
    """
    rough = scanned or cost
    count = int(np.ceil(np.log(range_hz[1] / range_hz[0]) / np.log(_COARSE))) + 1
    scan = np.geomspace(*range_hz, count).tolist()
    best = _best(kind, rough, [(f, f, zeta) for f in scan for zeta in damping_ratios])
    best = _best(kind, rough, [(f, best.frequency_hz[1], best.damping_ratio) for f in scan], best)
    best = _best(kind, rough, [(best.frequency_hz[0], f, best.damping_ratio) for f in scan], best)
    if scanned is not None:
        best = replace(best, cost=float(cost(best.x, best.y)))
    step = float(np.sqrt(_COARSE))
    while step > 1 + tolerance:
        x, y = best.frequency_hz
        around = [(x * step, y), (x / step, y), (x, y * step), (x, y / step)]
        nearby = _best(kind, cost, [(*pair, best.damping_ratio) for pair in around], best)
        if nearby is best:
            step = float(np.sqrt(step))
        best = nearby
    return best


def _best(
    kind: str, cost: ShaperCost, candidates: Iterable[tuple[float, float, float]], so_far: Fixed | None = None
) -> Fixed:
    """Return the best of candidates (x Hz, y Hz, damping ratio) and the best so far, which wins a tie."""
    tried = [] if so_far is None else [so_far]
    for x_hz, y_hz, zeta in candidates:
        x, y = SHAPERS[kind](x_hz, zeta), SHAPERS[kind](y_hz, zeta)
        tried.append(Fixed(x, y, (x_hz, y_hz), zeta, float(cost(x, y))))
    return min(tried, key=lambda each: each.cost)


# ---- settings that are all positive numbers -------------------------------------------------------

_FIRST_STEP, _LAST_STEP = 1.12, 1.012  # ratios

Cost = Callable[[FloatArray], float]  # of settings (k,)


@dataclass(frozen=True, slots=True)
class Scan:
    """Factors that are tried on some of the settings at once."""

    which: Sequence[int]
    factors: Sequence[float]


@dataclass(frozen=True, eq=False)
class Optimum:
    """The best settings, and their cost."""

    settings: FloatArray  # (k,)
    cost: float


def search(cost: Cost, start: FloatArray, scans: Sequence[Scan] = (), free: Sequence[int] | None = None) -> Optimum:
    """Find settings with less cost than any neighbour some 1 % away, along each of them.

    Parameters
    ----------
    cost : infinite where settings are not allowed
    start : (k,) above zero
    scans : one after the other, each from the best so far
    free : what steps may change; None: all
    """
    best = Optimum(np.asarray(start, dtype=float), cost(start))
    for scan in scans:
        best = _least(cost, [_times(best.settings, scan.which, factor) for factor in scan.factors], best)
    step = _FIRST_STEP
    indices = range(len(start)) if free is None else free
    while step > _LAST_STEP:
        before = best.cost
        for k in indices:
            best = _along(cost, best, k, step)
        if best.cost >= before:
            step = float(np.sqrt(step))
    return best


def _along(cost: Cost, best: Optimum, index: int, step: float) -> Optimum:
    """Step along one setting for as long as it gets better, up or else down."""
    for ratio in (step, 1 / step):
        moved = best
        while (further := _least(cost, [_times(moved.settings, [index], ratio)], moved)) is not moved:
            moved = further
        if moved is not best:
            return moved
    return best


def _least(cost: Cost, tried: Sequence[FloatArray], so_far: Optimum) -> Optimum:
    """Return the best of all; what was best so far wins a tie."""
    return min([so_far, *(Optimum(each, cost(each)) for each in tried)], key=lambda optimum: optimum.cost)


def _times(settings: FloatArray, which: Sequence[int], factor: float) -> FloatArray:
    changed = settings.copy()
    changed[list(which)] *= factor
    return changed
