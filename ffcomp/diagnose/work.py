"""How much a search may simulate: a budget of integration steps, so that no verdict takes for ever.

Steps are counted and not seconds, so that the same recordings get the same verdict on every computer, however busy.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

BUDGET = 1.5e8  # integration steps; one to two minutes of CPU in 2026, where everything is tried
ANEW = 0.5e8  # of a search that begins anew, at the motions' beginnings


@dataclass
class Work:
    """What was simulated so far, and how much may be before a search tries nothing more."""

    limit: float = inf
    steps: float = 0.0
    cut: bool = False  # something was left untried

    def add(self, steps: float) -> None:
        """Count what is simulated."""
        self.steps += steps

    def allows(self) -> bool:
        """Tell whether another thing may be tried; where it may not, that is remembered."""
        spent = self.steps >= self.limit
        self.cut = self.cut or spent
        return not spent

    def begin(self, limit: float) -> None:
        """Begin a search that may simulate so much from now on."""
        self.limit, self.cut = self.steps + limit, False

    def extend(self, further: float) -> None:
        """Allow so much from now on, if there is no more left."""
        self.limit = max(self.limit, self.steps + further)
