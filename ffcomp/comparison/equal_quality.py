"""The highest acceleration that keeps a method's contour error below a bound."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ffcomp.comparison.evaluation import Execution, Piece, Progress, contour, execute, in_parallel
from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.result import EqualQuality
from ffcomp.comparison.sampling import Print, PrintSlice, accelerated
from ffcomp.metrics import contour_statistics
from models.machine import Machine

LOWEST, HIGHEST, USUAL = 250.0, 40_000.0, 3000.0  # mm/s²
BRACKET_RATIO = 1.03  # ratio of too fast to acceptable where the search ends
ROUNDS, USUAL_ROUNDS = 10, 5
QUALITY = "seeking equal quality"  # the stage
LEAST_STEP, LARGEST_STEP = 1.02, 12.0  # factors, until the bound is found from both sides
OVERSHOOT = 1.012  # by how much a trial aims beyond the bound
POWER_RANGE = (0.3, 3.0)  # of the acceleration, that errors may go with


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

    Parameters
    ----------
    slices : evaluated at every acceleration; half a minute of print is enough
    bound_um : of the contour error's 99th percentile
    p99_um : by method, at the print's acceleration: where the search begins
    """
    stated = printed.acceleration_mm_per_s2 or USUAL
    searches = [
        Search(bound_um, begin(stated, bound_um / max(p99_um[m.name], 1e-9)), tried=[(stated, p99_um[m.name])])
        for m in tuned
    ]
    for number in range(ROUNDS):
        todo = [k for k, search in enumerate(searches) if not search.done]
        if not todo:
            break
        accelerations = [searches[k].next() for k in todo]

        def tell(what: str, share: float, begun: int = number) -> None:
            progress(QUALITY, min((begun + share) / USUAL_ROUNDS, 0.99))

        p99 = _p99_um([tuned[k] for k in todo], accelerations, slices, plant, tell)
        for k, *point in zip(todo, accelerations, p99, strict=True):
            searches[k].take(*point)
    progress(QUALITY, 1.0)
    return {method.name: search.result(printed) for method, search in zip(tuned, searches, strict=True)}


def begin(stated: float, factor: float) -> float:
    """Return where a search begins: errors grow about in proportion to the acceleration."""
    return min(max(stated * min(factor, LARGEST_STEP) ** (0.85 if factor > 1.0 else 1.0), LOWEST), HIGHEST)


@dataclass
class Search:
    """One method's search: the highest acceleration that is known to be good, and the lowest that is not."""

    bound_um: float
    first: float  # mm/s²
    good: tuple[float, float] | None = None  # mm/s² and µm
    bad: tuple[float, float] | None = None
    tried: list[tuple[float, float]] = field(default_factory=list)  # mm/s² and µm: hints of before may be the first
    alike: int = 0  # trials that ended on the same side of the bound as the one before

    def take(self, acceleration: float, p99_um: float) -> None:
        """Learn the error at an acceleration."""
        self.tried.append((acceleration, p99_um))
        one_side = self.good is None or self.bad is None
        self.alike = self.alike + 1 if one_side and (self.good or self.bad) else 0
        if p99_um <= self.bound_um:
            self.good = acceleration, p99_um
        else:
            self.bad = acceleration, p99_um

    @property
    def done(self) -> bool:
        """Whether more trials would add nothing."""
        if self.bad is None:
            return self.capped
        if self.good is None:
            return self.bad[0] <= LOWEST
        return self.bad[0] <= BRACKET_RATIO * self.good[0]

    @property
    def capped(self) -> bool:
        """Whether even the highest is good."""
        return self.good is not None and self.good[0] >= HIGHEST

    def next(self) -> float:
        """Return the next acceleration to try: a little beyond where the bound is expected, then before it."""
        if self.bad is None and self.good is None:
            return self.first
        if self.good is not None and self.bad is not None:
            return self._between()
        last = self.good or self.bad or (self.first, np.inf)
        step = float(np.clip(self._ratio(last) * OVERSHOOT ** (1 if self.good else -1), 1 / LARGEST_STEP, LARGEST_STEP))
        least = LEAST_STEP ** (4**self.alike)  # after misses, look farther and farther away
        step = max(step, least) if self.good else min(step, 1 / least)
        return float(min(max(last[0] * step, LOWEST), HIGHEST))

    def _ratio(self, last: tuple[float, float]) -> float:
        """Return the factor of acceleration that meets the bound, from the last two errors."""
        if not np.isfinite(last[1]):
            return 0.5
        others = [each for each in self.tried if each[0] != last[0] and np.isfinite(each[1])]
        power = 1.0  # errors grow about in proportion
        if others:
            a, error = min(others, key=lambda each: abs(np.log(each[0] / last[0])))
            slope = np.log(max(last[1], 1e-9) / max(error, 1e-9)) / np.log(last[0] / a)
            power = float(np.clip(slope, *POWER_RANGE))
        return float((self.bound_um / max(last[1], 1e-9)) ** (1 / power))

    def _between(self) -> float:
        """Interpolate in logarithms and step slightly beyond the root, which brackets it from both sides.

        Where one side's error is infinite, and every third time, halve.
        """
        assert self.good is not None and self.bad is not None
        low, high = np.log(self.good[0]), np.log(self.bad[0])
        middle, over = (low + high) / 2, 0.97 * np.log(BRACKET_RATIO)
        if not np.isfinite(self.bad[1]) or len(self.tried) % 3 == 0 or low + over > high - over:
            return float(np.exp(middle))
        errors = np.log(np.maximum([self.good[1], self.bad[1]], 1e-9) / self.bound_um)
        share = -errors[0] / max(errors[1] - errors[0], 1e-9)
        return float(np.exp(np.clip(low + share * (high - low), low + over, high - over)))

    def result(self, printed: Print) -> EqualQuality:
        """Return the highest good acceleration, and the whole print's time with it."""
        reached = self.good is not None
        acceleration, p99 = self.good or self.bad or (self.first, np.inf)
        plan = accelerated(printed.planned, printed.machine, acceleration)
        return EqualQuality(acceleration, plan.trajectory.end_t, p99, capped=self.capped, reached=reached)


def _p99_um(
    tuned: Sequence[TunedMethod],
    accelerations: Sequence[float],
    slices: Sequence[PrintSlice],
    plant: Machine,
    progress: Progress,
) -> list[float]:
    """Return each method's 99th percentile at its acceleration; infinite if its command breaks a carriage's limit."""
    tasks = [
        partial(_pieces, method, [each.with_acceleration(acceleration) for each in slices])
        for method, acceleration in zip(tuned, accelerations, strict=True)
    ]
    pieces = in_parallel(tasks, "", lambda what, share: progress(what, share / 2))
    together, tell = [piece for group in pieces for piece in group], lambda what, share: progress(what, (1 + share) / 2)
    executions = execute(plant, together, "", tell, coarse=True)
    p99, at = [], 0
    for group in pieces:
        executed, at = executions[at : at + len(group)], at + len(group)
        p99.append(_of(executed))
    return p99


def _of(executions: Sequence[Execution]) -> float:
    return contour_statistics(contour(executions)).p99_um if executions else np.inf


def _pieces(method: TunedMethod, slices: Iterable[PrintSlice]) -> list[Piece]:
    """Command every slice; none where the command breaks a limit."""
    pieces: list[Piece] = []
    for each in slices:
        motion, _ = method.motion(each)
        if not within_limits(*motion.peaks(each.machine), each.machine):
            return []
        pieces.append((each, motion))
    return pieces


def within_limits(velocity: float, acceleration: float, machine: Machine) -> bool:
    """Return whether the machine file allows its carriages such a command; a thousandth over is rounding."""
    limits = machine.limits
    return (
        velocity <= 1.001 * limits.carriage_velocity_mm_per_s
        and acceleration <= 1.001 * limits.carriage_acceleration_mm_per_s2
    )
