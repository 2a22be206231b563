"""The highest acceleration that keeps a method's contour error below a bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np

from ffcomp.comparison.evaluation import Progress, contour, execute, in_parallel
from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.result import EqualQuality
from ffcomp.comparison.sampling import Print, PrintSlice, accelerated
from ffcomp.faster.search import secant
from ffcomp.metrics import contour_statistics
from models.machine import Machine

USUAL = 3000.0  # mm/s², of a print that states no acceleration
LOWEST, HIGHEST = 250.0, 40_000.0  # mm/s², that are tried
BRACKET_RATIO = 1.03  # ratio of too fast to acceptable where the search ends
ROUNDS, USUAL_ROUNDS = 10, 4
QUALITY = "seeking equal quality"  # the stage
POWERS = (0.2, 2.5)  # of the acceleration, that errors may go with: the print may be at its speed already
AIM = 0.995  # times the bound, of a trial


def equal_qualities(
    tuned: Sequence[TunedMethod],
    printed: Print,
    plant: Machine,
    slices: Sequence[PrintSlice],
    bound_um: float,
    p99_um: Mapping[str, float],
    progress: Progress,
) -> dict[str, EqualQuality]:
    """Find each method's highest acceleration. A command beyond the carriages' limits is too fast.

    All methods are tried at once, each at an acceleration of its own: their printers go side by side.

    slices : evaluated at every acceleration; half a minute of print is enough
    bound_um : of the contour error's 99th percentile
    p99_um : by method, at the print's acceleration: where the search begins
    """
    stated = printed.acceleration_mm_per_s2 or USUAL
    searches = [Search([(stated, p99_um[method.name] / bound_um)]) for method in tuned]
    for number in range(ROUNDS):
        todo = [k for k, search in enumerate(searches) if not search.done]
        if not todo:
            break
        accelerations = [searches[k].next() for k in todo]

        def tell(what: str, share: float, begun: int = number) -> None:
            progress(QUALITY, min((begun + share) / USUAL_ROUNDS, 0.99))

        p99 = _p99_um([tuned[k] for k in todo], accelerations, slices, plant, tell)
        for k, acceleration, error_um in zip(todo, accelerations, p99, strict=True):
            searches[k].tried.append((acceleration, error_um / bound_um))
    progress(QUALITY, 1.0)
    return {method.name: search.result(printed, bound_um) for method, search in zip(tuned, searches, strict=True)}


@dataclass(frozen=True)
class Search:
    """One method's search, by the secant method that `compensate --max-error-um` has, inside what is known.

    tried : accelerations, mm/s², and their errors, times the bound; the first, a hint, is not of the same slices
    """

    tried: list[tuple[float, float]]

    @property
    def good(self) -> tuple[float, float] | None:
        """The highest acceleration that keeps the bound."""
        return max((each for each in self.tried[1:] if each[1] <= 1.0), default=None)

    @property
    def bad(self) -> tuple[float, float] | None:
        """The lowest that does not; its error is infinite if a command breaks a limit."""
        return min((each for each in self.tried[1:] if each[1] > 1.0), default=None)

    @property
    def done(self) -> bool:
        """Whether more trials would add nothing."""
        if (good := self.good) is None:
            return self.bad is not None and self.bad[0] <= LOWEST
        near = self.tried[-1] == good and self._sought(1.0) <= BRACKET_RATIO * good[0]
        return near or self.capped or (self.bad is not None and self.bad[0] <= BRACKET_RATIO * good[0])

    @property
    def capped(self) -> bool:
        """Whether even the highest is good."""
        return self.good is not None and self.good[0] >= HIGHEST

    def next(self) -> float:
        """Return the next acceleration to try."""
        good, bad, sought = self.good, self.bad, self._sought(AIM)
        if bad is None:
            return sought if good is None else min(max(sought, good[0] * BRACKET_RATIO ** len(self.tried)), HIGHEST)
        if good is None:
            return sought if sought < bad[0] else max(bad[0] / 2, LOWEST)
        return sought if good[0] < sought < bad[0] else float(np.sqrt(good[0] * bad[0]))

    def _sought(self, times_the_bound: float) -> float:
        """Return where the error is expected to be so many times the bound."""
        known = [(acceleration, max(error, 1e-9)) for acceleration, error in self.tried if np.isfinite(error)]
        return float(np.clip(secant(known, 1.0, times_the_bound, POWERS), LOWEST, HIGHEST))

    def result(self, printed: Print, bound_um: float) -> EqualQuality:
        """Return the highest good acceleration, and the whole print's time with it."""
        acceleration, error = self.good or self.bad or self.tried[0]
        plan = accelerated(printed.planned, printed.machine, acceleration)
        p99_um, reached = error * bound_um, self.good is not None
        return EqualQuality(acceleration, plan.trajectory.end_t, p99_um, capped=self.capped, reached=reached)


def _p99_um(
    tuned: Sequence[TunedMethod],
    accelerations: Sequence[float],
    slices: Sequence[PrintSlice],
    plant: Machine,
    progress: Progress,
) -> list[float]:
    """Return each method's 99th percentile at its acceleration; infinite if its command breaks a carriage's limit."""
    tasks = [
        partial(method.commands, [each.with_acceleration(acceleration) for each in slices])
        for method, acceleration in zip(tuned, accelerations, strict=True)
    ]
    commanded = in_parallel(tasks, "", lambda what, share: progress(what, share / 2))
    allowed = [each.pieces if each.peaks.within_limits else [] for each in commanded]
    together, tell = (
        [piece for group in allowed for piece in group],
        lambda what, share: progress(what, (1 + share) / 2),
    )
    executions = iter(execute(plant, together, "", tell, coarse=True))
    executed = [list(islice(executions, len(group))) for group in allowed]
    return [contour_statistics(contour(group)).p99_um if group else np.inf for group in executed]
