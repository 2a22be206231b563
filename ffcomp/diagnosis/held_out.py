"""Predict data that were left out of a fit.

Every place is left out in turn (every experiment, where there is one place only): what a hypothesis says of it then is
what it would say of a place that nobody has measured.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ffcomp.diagnosis.fidelity import quickest
from ffcomp.diagnosis.fit import EstimationProblem, Fit, step_within, values_at
from ffcomp.diagnosis.observations import Position, clustered
from ffcomp.diagnosis.problem import Problem
from ffcomp.diagnosis.recording_clocks import clock_parameters
from models.arrays import FloatArray

SHARES = (1.0, 0.4, 0.1)  # of a step, that are tried until one helps


@dataclass(frozen=True)
class HeldOut:
    """A place left out of the fit: the discrepancy there, as shares of its noise (χ² by row, less one)."""

    json_keys: ClassVar = {"recording": "recording", "before": "nrms.0", "after": "nrms.1"}

    position: Position
    experiment: str  # where experiments take turns because there is one place only; else ""
    rows: int
    before: float  # with the machine's parameters retuned at the other positions
    after: float  # with the effects as well
    filed: float = np.inf  # with the original file
    signal: float = np.inf  # with nothing simulated at all
    # in the band: of the error with the file as it is, and with the effects; of the signals; of the noise
    power: tuple[float, ...] = ()

    @property
    def label(self) -> str:
        """Name what was left out: `(55, 20)`, an experiment, or the time at which a window begins."""
        if len(self.position) == 1:
            return f"{self.position[0]:g} s"
        return self.experiment or f"({', '.join(f'{x:.0f}' for x in self.position)})"

    @property
    def recording(self) -> str:
        """Name the recording of a motion of an axis."""
        return Path(self.experiment.rpartition(" from ")[0]).name

    @property
    def nrms(self) -> tuple[float, float]:
        """The error with the file as it is, and with the effects: shares of the signals."""
        filed, after, signals, _ = self.power
        return float(np.sqrt(filed / signals)), float(np.sqrt(after / signals))


Groups = Mapping[tuple[Position, str], list[int]]


def groups(problem: Problem) -> Groups:
    """Group the observations that are held out together, by index: places with all their experiments and repeats.

    With a single place whole experiments with their repeats take turns; a single experiment leaves nothing to hold out.
    """
    observations = problem.observations
    places = clustered([o.position for o in observations])
    members: dict[tuple[Position, str], list[int]] = {}
    several = len(set(places)) > 1
    for i, (place, o) in enumerate(zip(places, observations, strict=True)):
        members.setdefault((place, "" if several else o.repeat_of), []).append(i)
    return members if len(members) > 1 else {}


def motions_or_groups(problem: Problem) -> Groups:
    """Group the observations as `groups` does, but those of an axis by its motions, where there are several.

    The windows of one motion depend on each other: vibration continues from one to the next, and so does the place of
    rest. Only another motion tests how an effect depends on place or speed.
    """
    observations, motions = problem.observations, problem.motions
    if len(set(motions)) < 2 or any(len(o.position) > 1 for o in observations):
        return groups(problem)
    first = [motions.index(motion) for motion in sorted(set(motions))]
    return {(observations[i].position, observations[i].name): _members(motions, motions[i]) for i in first}


def _members(motions: Sequence[int], one: int) -> list[int]:
    return [i for i, motion in enumerate(motions) if motion == one]


def hold_out(estimation: EstimationProblem, base: Fit, best: Fit, parts: Groups | None = None) -> list[HeldOut]:
    """Leave each group out in turn, of both fits."""
    parts = groups(estimation.problem) if parts is None else parts
    before = left_out(estimation, base, parts)
    after = before if best is base else left_out(estimation, best, parts)
    each = []
    for ((position, experiment), members), alone, effects in zip(parts.items(), before, after, strict=True):
        rows, filed = estimation.rows_of(members), estimation.limited_to(members).residual({})
        signals, scale = estimation.measured[rows], estimation.whiten.scale[rows]
        excess = (float(x @ x) / len(x) - 1 for x in (alone, effects, filed, signals))
        power = (float(np.sum((scale * x) ** 2)) for x in (filed, effects, signals, np.ones(len(rows))))
        known = dict(zip(("before", "after", "filed", "signal"), excess, strict=True))
        each.append(HeldOut(position, experiment, len(rows), **known, power=tuple(power)))
    return each


def beyond_noise(residual: FloatArray) -> float:
    """Return how much of |r|² stands above noise."""
    return max(float(residual @ residual) - len(residual), 0.0)


def left_out(estimation: EstimationProblem, fitted: Fit, parts: Groups, retuned: bool = False) -> list[FloatArray]:
    """Return what each group leaves, whitened, (rows,) each, with the parameters that the others alone give.

    Delays of its own recordings do not depend on the machine: no other recording determines them. But a late machine
    and late recordings are hard to tell apart, so that they are fitted to the group, and nothing else is.

    retuned : the file's numbers are fitted to each group, too, within their uncertainties
    """
    ranked, residuals = quickest(estimation, fitted.values)[0], list[FloatArray]()
    of_machine = {n.name for n in fitted.parameters if not n.name.startswith("effects.")}
    for members in parts.values():
        delays = clock_parameters([estimation.problem.observations[i] for i in members])
        others = [i for i in range(len(estimation.problem.observations)) if i not in members]
        known = {n.name for n in fitted.parameters} - delays
        z = _refitted(ranked, fitted, fitted.z, others, known, 1)
        z = _refitted(estimation, fitted, z, members, of_machine if retuned else delays, 3)
        residuals.append(estimation.limited_to(members).residual(values_at(fitted.parameters, z)))
    return residuals


def _refitted(
    estimation: EstimationProblem,
    fitted: Fit,
    z: FloatArray,
    members: Sequence[int],
    names: Collection[str],
    steps: int,
) -> FloatArray:
    """Return z (p,) with some parameters fitted to these observations alone, by the derivatives that are known."""
    which = [i for i, n in enumerate(fitted.parameters) if n.name in names]
    if not which:
        return z
    alone, j = estimation.limited_to(members), fitted.jacobian[estimation.rows_of(members)][:, which]
    parameters, prior = [fitted.parameters[i] for i in which], fitted.prior[which]
    normal, residual = np.diag(prior) + j.T @ j, alone.residual(values_at(fitted.parameters, z))
    for _ in range(steps):
        step = step_within(parameters, z[which], normal, j.T @ residual - prior * z[which])
        for share in SHARES:
            trial = z.copy()
            trial[which] += share * step
            there = alone.residual(values_at(fitted.parameters, trial))
            if _cost(there, trial[which], prior) < _cost(residual, z[which], prior):
                z, residual = trial, there
                break
        else:
            break
    return z


def _cost(residual: FloatArray, z: FloatArray, prior: FloatArray) -> float:
    return float(residual @ residual + z @ (prior * z))


def by_place(estimation: EstimationProblem) -> bool:
    """Tell whether places may bend the file's numbers; an axis has one, and its motions share them."""
    return any(len(o.position) > 1 for o in estimation.problem.observations)


def left_of(held_out: Sequence[HeldOut]) -> float:
    """Return the share of it that is left, in units of the noise or of the signals, whichever is larger.

    Where one band is loud or quiet by far, one of the two is blind to all others.
    """
    white = sum(max(one.after, 0.0) * one.rows for one in held_out) / max(to_explain(held_out), 1e-300)
    filed, after, signals, noise = np.sum([one.power for one in held_out], axis=0)
    return max(white, float(max(after - noise, 0.0) / max(min(filed, signals) - noise, 1e-300)))


def to_explain(held_out: Sequence[HeldOut]) -> float:
    """Return how much there is to explain where it was left out: by the better of the file and of retuning.

    An axis that nothing holds may be simulated worse than if it stood still: what ends that explains nothing.
    """
    return min(sum(max(getattr(one, key), 0.0) * one.rows for one in held_out) for key in ("before", "filed", "signal"))


def other_motions(estimation: EstimationProblem, base: Fit, best: Fit) -> list[HeldOut]:
    """Leave each motion of an axis out of the fit, whole; none where there is only one, or places take turns."""
    parts = motions_or_groups(estimation.problem)
    return [] if parts.keys() == groups(estimation.problem).keys() else hold_out(estimation, base, best, parts)
