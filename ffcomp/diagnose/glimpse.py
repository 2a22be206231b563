"""Glimpses: the motions in which most of the discrepancy is, where many candidates are ranked roughly.

A search asks several hundred times where an effect had best begin, and which of its shapes is nearest. What a
hypothesis leaves unexplained is seldom spread evenly: the motions that hold most of it rank its successors as all of
them do. The best ones are then simulated in every motion before they are compared with each other (successive halving:
Jamieson & Talwalkar, AISTATS 2016).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit
from models.arrays import FloatArray

MOST = 0.5  # of the residual's square, which the motions of a glimpse hold
LEAST_MOTIONS = 2
WORTHWHILE = 0.7  # of the motions: with more of them a glimpse saves too little


@dataclass(frozen=True, eq=False)
class Glimpse:
    """A problem and a fit of it, in a few motions."""

    estimation: EstimationProblem
    fit: Fit


def glimpse_of(estimation: EstimationProblem, fitted: Fit) -> Glimpse | None:
    """Return the motions in which most of a fit's residual is; None where that would hardly be quicker."""
    if estimation.only is not None:
        return None  # it is one already
    chosen = telling_motions(estimation, fitted.residual)
    motions = estimation.problem.motions
    if len(chosen) > WORTHWHILE * len(set(motions)):
        return None
    seen = [i for i, motion in enumerate(motions) if motion in chosen]
    rows = estimation.rows_of(seen)
    part = Fit(fitted.parameters, fitted.z, fitted.residual[rows], fitted.jacobian[rows])
    return Glimpse(estimation.limited_to(seen), part)


def telling_motions(estimation: EstimationProblem, residual: FloatArray) -> Sequence[int]:
    """Return as few motions as hold most of a residual, those that hold most of it first."""
    squares = _squares(estimation, residual)
    ranked, enough = sorted(squares, key=lambda motion: -squares[motion]), MOST * sum(squares.values())
    for n in range(LEAST_MOTIONS, len(ranked)):
        if sum(squares[motion] for motion in ranked[:n]) >= enough:
            return ranked[:n]
    return ranked


def quietest_motions(estimation: EstimationProblem, residual: FloatArray) -> Sequence[int]:
    """Return all motions, those first of which a fit leaves least."""
    squares = _squares(estimation, residual)
    return sorted(squares, key=lambda motion: squares[motion])


def _squares(estimation: EstimationProblem, residual: FloatArray) -> dict[int, float]:
    """Return each motion's square of a residual."""
    squares: dict[int, float] = {}
    for motion, rows in zip(estimation.problem.motions, estimation.whiten.rows, strict=True):
        squares[motion] = squares.get(motion, 0.0) + float(residual[rows] @ residual[rows])
    return squares
