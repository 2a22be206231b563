"""Search positive settings, such as a shaper's, with the least cost: scans, then ever finer steps about the best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.arrays import FloatArray

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


def search(cost: Cost, start: FloatArray, scans: Sequence[Scan] = ()) -> Optimum:
    """Find settings with less cost than any neighbour some 1 % away, along each of them.

    cost : infinite where settings are not allowed
    start : (k,) above zero
    scans : one after the other, each from the best so far
    """
    best = Optimum(np.asarray(start, dtype=float), cost(start))
    for scan in scans:
        best = _least(cost, [_times(best.settings, scan.which, factor) for factor in scan.factors], best)
    step = _FIRST_STEP
    while step > _LAST_STEP:
        before = best.cost
        for k in range(len(start)):
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
    """Return the best of all; the earlier best wins a tie."""
    return min([so_far, *(Optimum(each, cost(each)) for each in tried)], key=lambda optimum: optimum.cost)


def _times(settings: FloatArray, which: Sequence[int], factor: float) -> FloatArray:
    changed = settings.copy()
    changed[list(which)] *= factor
    return changed
