"""Acceptance tests: what a hypothesis must pass before its effects are named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, clipped, step_within, values_at
from ffcomp.diagnose.hypotheses import SIGNIFICANT, Hypothesis, discrepancy_of, implausible, misfit
from ffcomp.diagnose.intervals import superfluous
from ffcomp.diagnose.problem import Problem
from ffcomp.identify.uncertainty import Estimate
from models.arrays import FloatArray

LEFT = 0.15  # of the discrepancy may be left; at one position
LEFT_NEAR, NEAR = 0.3, 0.44  # as much, if the error is then within 1.2 times the noise
SHARES = (1.0, 0.5, 0.2, 0.05, 0.0)  # of a step


@dataclass(frozen=True)
class HeldOut:
    """A position left out of the fit: the discrepancy there, as shares of its noise (χ² by row, less one)."""

    position: tuple[float, ...]
    before: float  # with the machine's parameters retuned at the other positions
    after: float  # with the effects as well
    rows: int
    power: tuple[float, ...]  # in the band: of the error with the file as it is, with the effects; of the signals

    def explained(self, tolerance: float) -> bool:
        """Whether little is left; `tolerance` is a share of the noise."""
        return self.after < max(LEFT * self.before, tolerance, min(LEFT_NEAR * self.before, NEAR))


def rejections(
    base: Fit, best: Hypothesis, held_out: Sequence[HeldOut], intervals: Mapping[str, Estimate], tolerance: float
) -> list[str]:
    """List the acceptance tests that a hypothesis fails, in words; none if it is accepted."""
    failed = []
    if (base.evidence - best.fit.evidence) / misfit(best.fit) < SIGNIFICANT:
        failed.append("it is not significantly better than retuning alone")
    if best.discrepancy > max(LEFT * discrepancy_of(base), tolerance):
        failed.append(f"{100 * best.discrepancy / discrepancy_of(base):.0f} % of the discrepancy is left")
    failed += [_unexplained(one, tolerance) for one in held_out if not one.explained(tolerance)]
    # where retuning alone explains the data as well, but by implausible parameters, there is nothing to gain
    if not implausible(base) and sum((one.before - one.after) * one.rows for one in held_out) < SIGNIFICANT:
        failed.append("data left out of the fit are simulated no better with it")
    for candidate in best.effects:
        if superfluous(candidate, intervals):
            failed.append(f"the interval of {candidate.name} includes no effect at all")
    return failed


def _unexplained(one: HeldOut, tolerance: float) -> str:
    at = ", ".join(f"{x:.0f}" for x in one.position)
    if one.before <= tolerance:
        return f"at ({at}), left out of the fit, it makes things worse"
    return f"at ({at}), left out of the fit, {100 * one.after / one.before:.0f} % remains"


def hold_out(estimation: EstimationProblem, base: Fit, best: Fit) -> list[HeldOut]:
    """Leave each position out in turn: move both fits to the optimum of the others, to first order; simulate there.

    With a single position the observations take turns instead: weaker, but better than nothing.
    """
    found = []
    for position, members in groups(estimation.problem).items():
        filed = estimation.problem.simulate({}, members)
        before, after = _left_out(estimation, base, members), _left_out(estimation, best, members)
        nothing = [np.zeros_like(y) for y in filed]
        power = tuple(_power(estimation, y, members) for y in (filed, after, nothing))
        excess = _excess(estimation, before, members), _excess(estimation, after, members)
        found.append(HeldOut(position, *excess, rows=len(estimation.rows_of(members)), power=power))
    return found


def groups(problem: Problem) -> dict[tuple[float, ...], list[int]]:
    """Group the observations that are held out together, by index: by position, or one by one."""
    positions: dict[tuple[float, ...], list[int]] = {}
    for i, observation in enumerate(problem.observations):
        positions.setdefault(observation.position, []).append(i)
    if len(positions) > 1:
        return positions
    return {(float(i),): [i] for i in range(len(problem.observations))}


def _left_out(estimation: EstimationProblem, fitted: Fit, members: Sequence[int]) -> list[FloatArray]:
    """Simulate these observations, (n, m) each, with the parameters that the others alone ask for.

    The parameters go as far along the step to the others' optimum, to first order, as serves the others best.
    """
    inside = np.ones(len(fitted.residual), dtype=bool)
    inside[estimation.rows_of(members)] = False
    j, r = fitted.jacobian[inside], fitted.residual[inside]
    normal, slope = np.eye(len(fitted.z)) + j.T @ j, j.T @ r - fitted.z
    step = step_within(fitted.parameters, fitted.z, normal, slope)
    trials = [clipped(fitted.parameters, fitted.z + share * step) for share in SHARES]
    residuals = estimation.residuals([values_at(fitted.parameters, z) for z in trials])
    costs = [float(x[inside] @ x[inside] + z @ z) for x, z in zip(residuals, trials, strict=True)]
    return estimation.problem.simulate(values_at(fitted.parameters, trials[int(np.argmin(costs))]), members)


def _excess(estimation: EstimationProblem, simulated: Sequence[FloatArray], members: Sequence[int]) -> float:
    left = estimation.measured[estimation.rows_of(members)] - estimation.whiten(simulated, members)
    return float(left @ left) / len(left) - 1


def _power(estimation: EstimationProblem, simulated: Sequence[FloatArray], members: Sequence[int]) -> float:
    """Power of the error, not whitened."""
    observations = [estimation.problem.observations[i] for i in members]
    parts = [
        estimation.whiten.spectrum(observation, observation.measured - y)[0]
        for observation, y in zip(observations, simulated, strict=True)
    ]
    return float(sum(np.sum(np.abs(part) ** 2) for part in parts))
