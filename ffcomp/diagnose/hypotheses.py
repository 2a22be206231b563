"""Hypotheses: some effects together with all parameters fitted, and how hypotheses are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit
from ffcomp.diagnose.problem import Candidate, Parameter
from ffcomp.diagnose.progress import Now, Progress
from ffcomp.diagnose.recording_delays import belongs_to_recording
from models.arrays import FloatArray

SIGNIFICANT = 10.0  # −2 ln Z
ADDED_SHARE = 0.4  # of the discrepancy must an added effect remove
NEARLY_ALL = 0.8  # as much, where no more is left than an error of the other effects' shapes may leave
TRACE = 3e-3  # of the discrepancy: a shape is never that exact
LARGE = 1.0  # discrepancy, of the noise, from which effects may be too strong to be linear
IMPLAUSIBLE = 3.0  # mean square of z that retuning may cost before another effect is looked for
CHANCE = 4.0  # standard deviations of a mean square that noise alone may reach in one observation of many
NEAR = 0.05  # of the noise, added where discrepancies are compared
OWN_NUMBERS = frozenset(  # effects that are a number of the file which is wrong
    {"belt_stiffness", "guide_damping", "effector_mass", "extruder_mount", "center_of_mass", "arm_inertia"}
)
CONTAINED = {"stribeck_friction": "coulomb_friction"}  # an effect that has all numbers of another, and more


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Some effects together, all parameters fitted: the machine's first, then the effects'."""

    effects: tuple[Candidate, ...]
    fit: Fit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, sorted."""
        return tuple(sorted(c.name for c in self.effects))

    @property
    def discrepancy(self) -> float:
        """See `discrepancy_of`."""
        return discrepancy_of(self.fit)

    @property
    def own(self) -> int:
        """Count the machine's own parameters."""
        return len(self.fit.parameters) - self.added

    @property
    def added(self) -> int:
        """Count the effects' parameters."""
        return sum(len(c.parameters) for c in self.effects)

    @property
    def own_parameters(self) -> tuple[Parameter, ...]:
        """The machine's own parameters."""
        return self.fit.parameters[: self.own]

    @property
    def effect_parameters(self) -> tuple[Parameter, ...]:
        """The effects' parameters."""
        return self.fit.parameters[self.own :]

    @property
    def effect_z(self) -> FloatArray:
        """Values of the effects' parameters as z, (p,)."""
        return self.fit.z[self.own :]


def contains(name: str, other: str) -> bool:
    """Tell whether one of two effects is the other with more numbers: both at once are twice the same."""
    return CONTAINED.get(name) == other or CONTAINED.get(other) == name


def may_join(name: str, names: Sequence[str]) -> bool:
    """Tell whether an effect is none of these, nor one of them with more or fewer numbers."""
    return name not in names and not any(contains(name, own) for own in names)


def discrepancy_of(fitted: Fit) -> float:
    """Return how far the cost stands above noise alone, as a share of it."""
    return fitted.cost / len(fitted.residual) - 1


def misfit(fitted: Fit) -> float:
    """Return the mean square of the whitened residual, at least one.

    Evidence is divided by it: the model's shapes are never exactly the machine's, so where a misfit is left, a
    difference in evidence says that much less.
    """
    return max(1.0, fitted.chi_squared / len(fitted.residual))


def significant(fitted: Fit, before: Fit, share: float = ADDED_SHARE) -> bool:
    """Tell whether the larger model is worth its cost, and removes a good share of the discrepancy."""
    remains = max(before.cost - len(before.residual), 0.0)
    gained = (before.evidence - fitted.evidence) / misfit(fitted)
    return gained > SIGNIFICANT and before.cost - fitted.cost > share * remains


def comparable(h: Hypothesis, best: Hypothesis, factor: float) -> bool:
    """Tell whether a hypothesis leaves at most `factor` times the discrepancy of the best."""
    return h.discrepancy + NEAR <= factor * max(best.discrepancy + NEAR, NEAR)


def likeliest(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Sort by evidence, the likeliest first."""
    return sorted(hypotheses, key=lambda h: h.fit.evidence)


def distinct(ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Keep the first hypothesis of each set of effects."""
    return [h for i, h in enumerate(ranked) if h.names not in [before.names for before in ranked[:i]]]


def implausible(fitted: Fit, own: int | None = None) -> bool:
    """Tell whether the file's numbers, among the first `own`, moved further than their uncertainties make likely.

    The clocks of recordings do not count: many of them that stay where they are would hide two numbers that do not.
    """
    moved = _moved(fitted, own)
    return sum(z**2 for _, z in moved) > IMPLAUSIBLE * len(moved)


def _moved(fitted: Fit, own: int | None) -> list[tuple[str, float]]:
    moved = zip(fitted.parameters[:own], fitted.z[:own], strict=True)
    return [(n.name, abs(float(z))) for n, z in moved if not belongs_to_recording(n.name)]


def moved_numbers(h: Hypothesis) -> list[tuple[str, float]]:
    """Return by how many of its uncertainties each of the file's own numbers moved, a recording's clock aside."""
    return _moved(h.fit, h.own)


def within_file(h: Hypothesis) -> bool:
    """Tell whether the file's own numbers moved no further than their uncertainties make likely."""
    return not implausible(h.fit, h.own)


def with_one_within_file(close: Sequence[Hypothesis], ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Add to the contenders the likeliest hypothesis that leaves the file's own numbers in reach, if none does.

    An effect that is a number of the file, as a belt's stiffness is, can be had by bending that number alone. Then
    something small beside it fits better than the effect does before it is fitted well.
    """
    held = next((h for h in ranked if within_file(h)), None)
    return list(close) if held is None or any(within_file(h) for h in close) else [*close, held]


def preferring_file(best: Hypothesis, tried: Sequence[Hypothesis], little: float) -> Hypothesis:
    """Prefer a hypothesis that leaves the file's own numbers in reach and but little of the discrepancy.

    One that bends them would be rejected for it, and nothing would be named.
    """
    held = [h for h in tried if within_file(h) and h.discrepancy < little]
    return best if within_file(best) else min(held, key=lambda h: h.fit.evidence, default=best)


def incomplete(estimation: EstimationProblem, h: Hypothesis) -> bool:
    """Tell whether a discrepancy is left somewhere, or implausible parameters were needed to close it."""
    return leaves_excess(estimation, h.fit) or implausible(h.fit, h.own)


def leaves_excess(estimation: EstimationProblem, fitted: Fit) -> bool:
    """Tell whether the residual stands above the noise, altogether or in any observation, by more than chance may do.

    The mean square of n rows of noise is one, give or take √(2/n): a short window stands out by chance alone.
    """
    parts = [fitted.residual, *(fitted.residual[rows] for rows in estimation.whiten.rows)]
    return any(float(r @ r) / len(r) - 1 > max(estimation.tolerance, CHANCE * np.sqrt(2 / len(r))) for r in parts)


def without_effect(h: Hypothesis, dropped: Candidate) -> Hypothesis:
    """Leave one effect out, everything else as it stands."""
    effects = tuple(c for c in h.effects if c.name != dropped.name)
    keep = [i for i, n in enumerate(h.fit.parameters) if n not in dropped.parameters]
    parameters = tuple(h.fit.parameters[i] for i in keep)
    return Hypothesis(effects, Fit(parameters, h.fit.z[keep], h.fit.residual, h.fit.jacobian[:, keep]))


def log_fit(h: Hypothesis, progress: Progress, note: str = "") -> Hypothesis:
    """Tell the progress of a hypothesis, and return it."""
    times = float(np.sqrt(max(1.0 + h.discrepancy, 0.0)))  # rms
    progress(f"{_effects(h.effects)}{note}: the error that is left is {times:.4g} times the noise")
    return h


def log_try(effects: Sequence[Candidate], progress: Progress, note: str = "") -> None:
    """Tell what is being fitted."""
    progress(Now(f"fitting {_effects(effects)}{note}"))


def _effects(effects: Sequence[Candidate]) -> str:
    return " + ".join(c.name for c in effects)
