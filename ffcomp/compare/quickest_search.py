"""The quickest feeds and acceleration at which a method's error stays under a bound, whatever the clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.compare.equal_quality import HIGHEST, LOWEST, p99_um
from ffcomp.compare.methods import TunedMethod
from ffcomp.compare.quickest_plans import Stretch, seconds_of
from models.machine import Machine

FEEDS = (1.0, 1.5, 2.25, 3.5, 0.7, 0.5, 0.35)  # times the slicer's, in the order in which they are tried
HALVINGS = 7  # of the ratio between the lowest and the highest acceleration: 4 % at the end


@dataclass(frozen=True, slots=True)
class Setting:
    """What a firmware is told."""

    feed: float
    acceleration_mm_per_s2: float
    reached: bool = True  # False: above the bound even here, the slowest that was tried


class Seeker:
    """Seeks one method's setting on some slices; error grows and time falls with acceleration."""

    def __init__(self, method: TunedMethod, stretches: Sequence[Stretch], plant: Machine, bound_um: float) -> None:
        self.method, self.stretches, self.plant, self.bound_um = method, stretches, plant, bound_um

    def setting(self, feeds: Sequence[float] = FEEDS) -> Setting:
        """Return the quickest setting that keeps the bound."""
        best: Setting | None = None
        best_s = np.inf
        for feed in feeds:
            lowest = self._quicker_than(best_s, feed)
            if lowest is None or not self._keeps(feed, lowest):
                continue
            acceleration = self._highest(feed, lowest)
            seconds = self._seconds(feed, acceleration)
            if seconds < best_s:
                best, best_s = Setting(feed, acceleration), seconds
        return best or Setting(min(feeds), LOWEST, reached=False)

    def _quicker_than(self, seconds: float, feed: float) -> float | None:
        """Return the lowest acceleration that is quicker than this; None: none is."""
        if self._seconds(feed, LOWEST) < seconds:
            return LOWEST
        if self._seconds(feed, HIGHEST) >= seconds:
            return None
        low, high = np.log(LOWEST), np.log(HIGHEST)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if self._seconds(feed, float(np.exp(middle))) < seconds else (middle, high)
        return float(np.exp(high))

    def _highest(self, feed: float, lowest: float) -> float:
        """Return the highest acceleration that keeps the bound; the lowest one does."""
        if self._keeps(feed, HIGHEST):
            return HIGHEST
        low, high = np.log(lowest), np.log(HIGHEST)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if self._keeps(feed, float(np.exp(middle))) else (low, middle)
        return float(np.exp(low))

    def _keeps(self, feed: float, acceleration: float) -> bool:
        slices = [each.at(feed, acceleration) for each in self.stretches]
        return p99_um(self.method, slices, self.plant) <= self.bound_um

    def _seconds(self, feed: float, acceleration: float) -> float:
        """Return the time of all slices, each kind of line as often as it is in the print, s."""
        total = 0.0
        for each in self.stretches:
            own = each.at(feed, acceleration)
            seconds = seconds_of(own.trajectory)
            total += float(seconds.sum() if own.weight is None else seconds @ own.weight)
        return total
