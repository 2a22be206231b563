"""The estimation problem: parameter values in, whitened residual out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.diagnose.noise import Whitener, whitener
from ffcomp.diagnose.problem import InfeasibleParameters, Problem
from models.arrays import FloatArray

WELL_KNOWN, GUESSED = 0.1, 3.0  # share of the noise to which its floor is known: from repeats, or without any
SURE = 3000.0  # χ² of a discrepancy above its expectation in which effects are told apart
RECENT = 48  # residuals that are held
INFEASIBLE = 1e6  # standard deviations, each entry of the residual of infeasible parameters


_Key = tuple[frozenset[tuple[str, float]], tuple[int, ...] | None, bool]


class Recent:
    """The residuals of the last few sets of values: a fit begins where the one before has ended."""

    def __init__(self) -> None:
        self._kept: dict[_Key, FloatArray] = {}

    def get(self, key: _Key) -> FloatArray | None:
        """Return the residual with these values, if it is known."""
        return self._kept.get(key)

    def add(self, key: _Key, residual: FloatArray) -> FloatArray:
        """Keep a residual as the newest, and return it."""
        self._kept.pop(key, None)
        for old in list(self._kept)[: 1 - RECENT]:
            del self._kept[old]
        self._kept[key] = residual
        return residual


@dataclass(frozen=True, eq=False)
class EstimationProblem:
    """A problem with its whitener."""

    problem: Problem
    whiten: Whitener
    measured: FloatArray  # (rows,) whitened
    coarse: bool = False  # quicker simulations
    given: Mapping[str, float] = field(default_factory=dict)  # values of parameters that are not fitted
    tolerance: float = WELL_KNOWN  # of the noise: a smaller discrepancy counts as none
    share: float = 1.0  # of all data
    only: tuple[int, ...] | None = None  # observations that are simulated; None: all
    recent: Recent = field(default_factory=Recent)  # shared by all that are made from this one on the same data

    def residual(self, values: Mapping[str, float]) -> FloatArray:
        """Return measured − simulated, whitened: (rows,)."""
        return next(self.residuals([values]))

    def residuals(self, many: Sequence[Mapping[str, float]]) -> Iterator[FloatArray]:
        """Evaluate several sets of values, in order; they are not to be written to."""
        asked = [{**self.given, **v} for v in many]
        keys = [(frozenset(v.items()), self.only, self.coarse) for v in asked]
        known = [self.recent.get(key) for key in keys]
        fresh = self._evaluated([v for v, found in zip(asked, known, strict=True) if found is None])
        for key, found in zip(keys, known, strict=True):
            yield self.recent.add(key, next(fresh) if found is None else found)

    def _evaluated(self, many: Sequence[Mapping[str, float]]) -> Iterator[FloatArray]:
        for simulated in self.problem.simulate_many(many, self.only, coarse=self.coarse):
            if isinstance(simulated, InfeasibleParameters):
                yield np.full(len(self.measured), INFEASIBLE)
            else:
                residual = self.measured - self.whiten(simulated, self.only)
                yield residual if np.isfinite(residual @ residual) else np.full(len(self.measured), INFEASIBLE)

    def limited_to(self, observations: Sequence[int]) -> EstimationProblem:
        """Return the problem with some of its observations only; their rows follow one another."""
        measured = self.measured[self.rows_of(observations)]
        share = self.share * len(measured) / len(self.measured)
        return replace(self, measured=measured, only=tuple(observations), share=share)

    def rows_of(self, observations: Sequence[int]) -> FloatArray:
        """Return the indices of the rows of some observations."""
        parts = [self.whiten.rows[i] for i in observations]
        return np.concatenate([np.arange(part.start, part.stop) for part in parts])


def estimation_problem(problem: Problem, whiten: Whitener) -> EstimationProblem:
    """Whiten the measurements; the tolerance follows from how well the noise is known."""
    tolerance = WELL_KNOWN if whiten.floor.from_repeats else GUESSED
    return EstimationProblem(problem, whiten, whiten([o.measured for o in problem.observations]), tolerance=tolerance)


def excerpt_of(estimation: EstimationProblem, discrepancy: float) -> EstimationProblem | None:
    """Return the problem on an excerpt of its data that shows such a discrepancy, of the noise, as surely.

    None where the discrepancy is too small for that, or there is no excerpt.
    """
    rows = len(estimation.measured)
    if discrepancy < 2 * estimation.tolerance or discrepancy * rows < SURE:
        return None
    problem = estimation.problem.excerpt()
    if problem is None:
        return None
    part = on_part(estimation, problem)
    return None if part.share * discrepancy * rows < SURE else part


def on_part(estimation: EstimationProblem, problem: Problem) -> EstimationProblem:
    """Return the estimation on a part of its problem's data, by the same noise."""
    whiten = whitener(problem.observations, estimation.whiten.floor, estimation.whiten.band_hz)
    measured = whiten([o.measured for o in problem.observations])
    share = estimation.share * len(measured) / len(estimation.measured)
    return replace(estimation, problem=problem, whiten=whiten, measured=measured, share=share, recent=Recent())
