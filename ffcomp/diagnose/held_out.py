"""What a fit says of experiments that were left out of it: by place, or one by one where there is one place only."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, clipped, fit, step_within, values_at
from ffcomp.diagnose.problem import Problem
from ffcomp.diagnose.recording_delays import own_delays
from models.arrays import FloatArray

APART_MM = 20.0  # from which two places count as two
LEFT = 0.15  # of the discrepancy may be left; at one position
LEFT_NEAR, NEAR = 0.3, 0.44  # as much, if the error is then within 1.2 times the noise
SHARES = (1.0, 0.5, 0.2, 0.05, 0.0)  # of a step

Position = tuple[float, ...]


@dataclass(frozen=True)
class HeldOut:
    """A place left out of the fit: the discrepancy there, as shares of its noise (χ² by row, less one)."""

    position: Position
    before: float  # with the machine's parameters retuned at the other positions
    after: float  # with the effects as well
    rows: int
    power: tuple[float, ...]  # in the band: of the error with the file as it is, with the effects; of the signals
    experiment: str = ""  # where experiments take turns, for there is one place only
    noise_power: float = 0.0  # of the noise alone, as `power`
    filed: float = 0.0  # the discrepancy with the file as it is

    def explained(self, tolerance: float) -> bool:
        """Whether little is left; `tolerance` is a share of the noise."""
        return self.after < max(LEFT * self.before, tolerance, min(LEFT_NEAR * self.before, NEAR))

    @property
    def label(self) -> str:
        """Name what was left out: `(55, 20)`, an experiment, or the time at which a window begins."""
        if len(self.position) == 1:
            return f"{self.position[0]:g} s"
        return self.experiment or f"({', '.join(f'{x:.0f}' for x in self.position)})"


def groups(problem: Problem) -> Mapping[tuple[Position, str], list[int]]:
    """Group the observations that are held out together, by index: places with all their experiments and repeats.

    With a single place whole experiments with their repeats take turns; a single experiment leaves nothing to hold out.
    """
    observations = problem.observations
    places = clustered([o.position for o in observations])
    found: dict[tuple[Position, str], list[int]] = {}
    several = len(set(places)) > 1
    for i, (place, o) in enumerate(zip(places, observations, strict=True)):
        found.setdefault((place, "" if several else o.repeat_of), []).append(i)
    return found if len(found) > 1 else {}


def clustered(positions: Sequence[Position]) -> list[Position]:
    """Return the place that each position (x, y) belongs to: the first of those less than 20 mm apart, in a chain.

    A position of one number is a window of time: it stands by itself.
    """
    label = list(range(len(positions)))
    for i, a in enumerate(positions):
        for k in range(i):
            near = a == positions[k] if len(a) == 1 else math.dist(a, positions[k]) < APART_MM
            if near and label[i] != label[k]:
                old, new = max(label[i], label[k]), min(label[i], label[k])
                label = [new if x == old else x for x in label]
    return [positions[x] for x in label]


def hold_out(estimation: EstimationProblem, base: Fit, best: Fit) -> list[HeldOut]:
    """Leave each group out in turn: move both fits to the optimum of the others, to first order; simulate there."""
    found = []
    for (position, experiment), members in groups(estimation.problem).items():
        filed = estimation.problem.simulate({}, members)
        before = _left_out(estimation, base, members)
        after = before if best is base else _left_out(estimation, best, members)
        nothing = [np.zeros_like(y) for y in filed]
        power = tuple(_power(estimation, y, members) for y in (filed, after, nothing))
        excess = [_excess(estimation, y, members) for y in (before, after, filed)]
        rows = len(estimation.rows_of(members))
        noise = _noise_power(estimation, members)
        found.append(HeldOut(position, excess[0], excess[1], rows, power, experiment, noise, excess[2]))
    return found


def _left_out(estimation: EstimationProblem, fitted: Fit, members: Sequence[int]) -> list[FloatArray]:
    """Simulate these observations, (n, m) each, with the parameters that the others alone ask for.

    The parameters go as far along the step to the others' optimum, to first order, as serves the others best.
    """
    inside = np.ones(len(fitted.residual), dtype=bool)
    inside[estimation.rows_of(members)] = False
    own = own_delays([estimation.problem.observations[i] for i in members])
    keep = [i for i, n in enumerate(fitted.parameters) if n.name not in own]
    free = tuple(fitted.parameters[i] for i in keep)
    j, r = fitted.jacobian[inside][:, keep], fitted.residual[inside]
    normal, slope = np.eye(len(keep)) + j.T @ j, j.T @ r - fitted.z[keep]
    step, moved = np.zeros(len(fitted.z)), step_within(free, fitted.z[keep], normal, slope)
    step[keep] = moved
    trials = [clipped(fitted.parameters, fitted.z + share * step) for share in SHARES]
    # the whole step, if it brings at least half of what it promises: then there is hardly a better one
    promised, before = float(2 * slope @ moved - moved @ normal @ moved), _cost(r, fitted.z)
    costs = _costs(estimation, fitted, trials[:1], inside)
    if not before - costs[0] > promised / 2:
        costs += _costs(estimation, fitted, trials[1:], inside)
    best = _on_their_clocks(estimation, fitted, trials[int(np.argmin(costs))], members)
    return estimation.problem.simulate(values_at(fitted.parameters, best), members)


def _on_their_clocks(estimation: EstimationProblem, fitted: Fit, z: FloatArray, members: Sequence[int]) -> FloatArray:
    """Put what was left out on clocks of its own: z (p,) with the delays of these recordings fitted to them alone.

    They say nothing of the machine, so nothing else tells them. But a late machine and late recordings are hard to
    tell apart: with other recordings the share of each is another, and clocks that stayed would be wrong by as much.
    """
    own = own_delays([estimation.problem.observations[i] for i in members])
    clocks = [i for i, n in enumerate(fitted.parameters) if n.name in own]
    if not clocks:
        return z
    others = [i for i in range(len(z)) if i not in clocks]
    given = values_at([fitted.parameters[i] for i in others], z[others])
    alone = replace(estimation.limited_to(members), given={**estimation.given, **given})
    columns = fitted.jacobian[estimation.rows_of(members)][:, clocks]
    found = fit(alone, tuple(fitted.parameters[i] for i in clocks), z[clocks], columns, iterations=3)
    moved = z.copy()
    moved[clocks] = found.z
    return moved


def _costs(
    estimation: EstimationProblem, fitted: Fit, trials: Sequence[FloatArray], inside: NDArray[np.bool_]
) -> list[float]:
    """Simulate everything with each of these z: the cost of each outside of what is left out."""
    residuals = estimation.residuals([values_at(fitted.parameters, z) for z in trials])
    return [_cost(x[inside], z) for x, z in zip(residuals, trials, strict=True)]


def _cost(residual: FloatArray, z: FloatArray) -> float:
    return float(residual @ residual + z @ z)


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


def _noise_power(estimation: EstimationProblem, members: Sequence[int]) -> float:
    """Power of the floor alone, in the same unit."""
    whiten, total = estimation.whiten, 0.0
    for observation in (estimation.problem.observations[i] for i in members):
        _, frequency = whiten.spectrum(observation, observation.measured)
        power = 2 * whiten.power(observation)
        total += sum(float(np.sum(whiten.floor.at(s, frequency))) * power for s in observation.signals)
    return total
