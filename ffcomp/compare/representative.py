"""Choose slices that stand for a whole print: the same kinds of line, heights and places, each in its share of time.

A print is partitioned three times: by kind of line (the slicer's feature, extruding or not), by height and by place. Of
all slices that could be taken, those are chosen whose shares together come nearest to the print's, outer walls counting
double. What is over- or underrepresented still is weighted (post-stratification by kind of line; W. G. Cochran,
Sampling Techniques, 3rd ed. 1977, 5A.9).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.arrays import BoolArray, FloatArray, IntArray

HEIGHTS = 3  # bands of layers
OUTER_WALLS_COUNT = 2.0  # they are what shows
EXCHANGED_UP_TO = 100  # slices; among more of them a single one matters little


@dataclass(frozen=True, eq=False)
class Strata:
    """The stratum of each of n moves in every partition of a print, and the time that it takes."""

    kind: IntArray  # (n,) twice the feature, and 1 where the move extrudes
    partitions: tuple[IntArray, ...]  # each (n,), from 0; the first is `kind`
    seconds: FloatArray  # (n,)
    outer: BoolArray  # (n,) is an outer wall

    @classmethod
    def of(
        cls,
        feature: IntArray,
        layer: IntArray,
        middle_mm: FloatArray,
        seconds: FloatArray,
        extrudes: BoolArray,
        outer: BoolArray,
    ) -> Strata:
        """Partition n moves.

        Parameters
        ----------
        feature, layer : (n,) arrays
        middle_mm : (n, 2) array
            Where each move is.
        seconds : (n,) array
        extrudes, outer : (n,) arrays
            Whether it extrudes, and whether it is an outer wall.
        """
        kind = 2 * feature + extrudes
        low, high = int(layer.min()), int(layer.max())
        height = (HEIGHTS * (layer - low)) // (high - low + 1)
        where = extrudes if extrudes.any() else np.ones(len(extrudes), dtype=np.bool_)
        east, north = (middle_mm > np.median(middle_mm[where], axis=0)).T
        return cls(kind, (kind, height, 2 * east + north), seconds, outer & extrudes)

    def amounts(self, begin: IntArray, end: IntArray) -> FloatArray:
        """Return the seconds (j, s) that each of j slices begin ≤ move < end spends in each of all s strata."""
        counted = self.seconds * np.where(self.outer, OUTER_WALLS_COUNT, 1.0)
        columns = []
        for partition in self.partitions:
            for stratum in range(int(partition.max()) + 1):
                until = np.concatenate([[0.0], np.cumsum(np.where(partition == stratum, counted, 0.0))])
                columns.append(until[end] - until[begin])
        return np.stack(columns, axis=1)

    def weights(self, chosen: FloatArray) -> FloatArray:
        """Return the weight (n,) of each move's samples, on average 1 over what is chosen.

        Parameters
        ----------
        chosen : (n,) array
            Seconds of each move that are evaluated.
        """
        whole = np.bincount(self.kind, self.seconds)
        taken = np.bincount(self.kind, chosen, len(whole))
        share = np.divide(whole, taken, out=np.zeros(len(whole)), where=taken > 0.0)
        return np.asarray(share[self.kind] * taken.sum() / max(whole[taken > 0.0].sum(), 1e-12))


def choose(amounts: FloatArray, target: FloatArray, begin_t: FloatArray, end_t: FloatArray, count: int) -> IntArray:
    """Return `count` of j slices (fewer if no more fit without overlap), in the order of time.

    Parameters
    ----------
    amounts : (j, s) array
        Seconds that each slice spends in each stratum.
    target : (s,) array
        Seconds of the whole print.
    begin_t, end_t : (j,) arrays
        Where each begins and ends, s; `begin_t` never falls.
    count : int
    """
    choice = _Choice(amounts, target / target.sum(), begin_t, end_t)
    chosen: list[int] = []
    while len(chosen) < count and (best := choice.nearest(chosen)) is not None:
        chosen.append(best)
    if len(chosen) <= EXCHANGED_UP_TO:  # now that the others are known
        for k in range(len(chosen)):
            best = choice.nearest(chosen[:k] + chosen[k + 1 :])
            chosen[k] = chosen[k] if best is None else best
    return np.array(sorted(chosen), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class _Choice:
    """What can be chosen."""

    amounts: FloatArray  # (j, s) s
    target: FloatArray  # (s,) shares
    begin_t: FloatArray  # (j,) s
    end_t: FloatArray  # (j,) s

    def nearest(self, chosen: list[int]) -> int | None:
        """Return the slice with which the shares come nearest to the target's; None if none is free."""
        free = self._free(chosen)
        if not free.any():
            return None
        together = self.amounts + self.amounts[chosen].sum(axis=0)
        seconds = np.maximum(together.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        off = np.abs(together / seconds - self.target).sum(axis=1)
        return int(np.argmin(np.where(free, off, np.inf)))

    def _free(self, chosen: list[int]) -> BoolArray:
        """Return which slices are not empty and overlap with none that is chosen: (j,)."""
        order = sorted(chosen, key=lambda k: self.begin_t[k])
        at = np.searchsorted(self.begin_t[order], self.begin_t)
        ends, begins = np.append(-np.inf, self.end_t[order]), np.append(self.begin_t[order], np.inf)
        free: BoolArray = (ends[at] <= self.begin_t) & (self.end_t <= begins[at]) & (self.amounts.sum(axis=1) > 0.0)
        return free & ~np.isin(np.arange(len(free)), chosen)
