"""Hypotheses: some effects together with all parameters fitted, and how hypotheses are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.diagnosis.fit import EstimationProblem, Fit
from ffcomp.diagnosis.noise import NoiseFloor
from ffcomp.diagnosis.problem import Candidate, Parameter
from ffcomp.diagnosis.recording_clocks import belongs_to_recording
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.numerics.stages import Now, Progress
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE

FILE_CHANGES = frozenset(name for name, effect in CATALOGUE.items() if effect.corrects_file)
NESTED = {name: effect.contains for name, effect in CATALOGUE.items() if effect.contains}
DRY, PULL = "dry friction", "a pull towards one place"
FAMILIES = {  # what is told first of an effect with several laws; of any other its name says it
    "coulomb_friction": DRY,
    "bristle_friction": DRY,
    "joint_friction": DRY,
    "stribeck_friction": "dry friction that falls with speed",
    "friction_by_load": "dry friction that grows with load",
    "friction_by_direction": "friction that differs by direction",
    "guide_damping": "viscous friction",
    "quadratic_drag": "friction that grows with the square of the speed",
    "pendulum_gravity": PULL,
    "ground_spring": PULL,
}
LAW_GROUPS = {  # laws of one thing, which differ by little: they are no rivals of each other
    "coulomb_friction": DRY,
    "bristle_friction": DRY,
    "stribeck_friction": DRY,
    "pendulum_gravity": PULL,
    "ground_spring": PULL,
}


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Some effects together, all parameters fitted: the machine's first, then the effects'."""

    effects: tuple[Candidate, ...]
    fit: Fit
    exact: bool = False  # fitted to the end with exact derivatives

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, sorted."""
        return tuple(sorted(c.name for c in self.effects))

    @property
    def discrepancy(self) -> float:
        """See `Fit.discrepancy`."""
        return self.fit.discrepancy

    @property
    def machine_count(self) -> int:
        """Number of the machine's parameters."""
        return len(self.fit.parameters) - self.effect_count

    @property
    def effect_count(self) -> int:
        """Number of the effects' parameters."""
        return sum(len(c.parameters) for c in self.effects)

    @property
    def machine_parameters(self) -> tuple[Parameter, ...]:
        """The machine's parameters."""
        return self.fit.parameters[: self.machine_count]

    @property
    def machine_jacobian(self) -> FloatArray:
        """Derivatives by the machine's parameters, (rows, machine_count)."""
        return self.fit.jacobian[:, : self.machine_count]

    @property
    def effect_parameters(self) -> tuple[Parameter, ...]:
        """The effects' parameters."""
        return self.fit.parameters[self.machine_count :]

    @property
    def effect_z(self) -> FloatArray:
        """Values of the effects' parameters as z, (effect_count,)."""
        return self.fit.z[self.machine_count :]

    @property
    def plausible(self) -> bool:
        """Whether the file's numbers moved no further than their uncertainties make likely."""
        return not implausible(self.fit, self.machine_count)

    def without(self, dropped: Candidate) -> Hypothesis:
        """Leave one effect out, everything else as it stands."""
        effects = tuple(c for c in self.effects if c.name != dropped.name)
        keep = [i for i, n in enumerate(self.fit.parameters) if n not in dropped.parameters]
        parameters = tuple(self.fit.parameters[i] for i in keep)
        return Hypothesis(effects, Fit(parameters, self.fit.z[keep], self.fit.residual, self.fit.jacobian[:, keep]))

    def at_file(self) -> Hypothesis:
        """Put the machine's parameters where the file has them, the effects as they stand; the fit is to be renewed."""
        z = np.concatenate([np.zeros(self.machine_count), self.effect_z])
        return Hypothesis(self.effects, replace(self.fit, z=z))


def nested(name: str, other: str) -> bool:
    """Tell whether one of two effects is the other with more numbers: both at once are twice the same."""
    return NESTED.get(name) == other or NESTED.get(other) == name


def may_join(name: str, names: Sequence[str]) -> bool:
    """Tell whether an effect is none of these, nor a law of the same thing: friction has one, however it is bent."""
    group = LAW_GROUPS.get(name, name)
    return not any(group == LAW_GROUPS.get(each, each) or nested(name, each) for each in names)


# ---- evidence ------------------------------------------------------------------------------------


def significant(larger: Fit, smaller: Fit, share: float = SETTINGS.added_share) -> bool:
    """Tell whether the larger model is worth its cost, and removes a good share of the discrepancy."""
    remains = max(smaller.cost - len(smaller.residual), 0.0)
    gain = (smaller.evidence - larger.evidence) / larger.misfit
    return gain > SETTINGS.significant and smaller.cost - larger.cost > share * remains


def worth(larger: Fit, smaller: Fit, floor: NoiseFloor, share: float = SETTINGS.added_share) -> bool:
    """Tell whether the larger model is significant, by a noise that is known.

    By one that is only guessed, any number of rows makes the smallest difference significant: there it must take a
    share of what is left.
    """
    enough = floor.from_repeats or larger.chi_squared < (1 - SETTINGS.exists) * smaller.chi_squared
    return enough and significant(larger, smaller, share)


def comparable(h: Hypothesis, best: Hypothesis, factor: float) -> bool:
    """Tell whether a hypothesis leaves at most `factor` times the discrepancy of the best."""
    least = SETTINGS.exists
    return h.discrepancy + least <= factor * max(best.discrepancy + least, least)


def likeliest(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Sort by evidence, the likeliest first."""
    return sorted(hypotheses, key=lambda h: h.fit.evidence)


def distinct(ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Keep the first hypothesis of each set of effects."""
    return [h for i, h in enumerate(ranked) if h.names not in [before.names for before in ranked[:i]]]


def competing_with(
    best: Hypothesis, tried: Sequence[Hypothesis], share: float = 1.0, gap: float = 0.0
) -> list[Hypothesis]:
    """List hypotheses of other effects, as many, that are nearly as likely, or that explain all but a trace too.

    Parameters
    ----------
    share : of the data, on which all were fitted: all of it would set them apart that much further.
    gap : the discrepancy without any effect, of the noise. Where it is large, even a small error of an effect's shape
        is significant, and no effect has exactly our shape: what leaves a thousandth of it cannot be ruled out.
    """
    scale = best.fit.misfit * share
    others = [h for h in tried if h.names != best.names and len(h.effects) == len(best.effects)]
    return [
        h
        for h in others
        if (h.fit.evidence - best.fit.evidence) / scale < SETTINGS.competing or h.discrepancy < SETTINGS.trace * gap
    ]


# ---- plausible numbers of the file ---------------------------------------------------------------


def moved_numbers(fitted: Fit, machine_count: int | None = None) -> list[tuple[str, float]]:
    """Return by how many of its uncertainties each of the file's numbers moved, among the first parameters.

    The clocks of recordings do not count: many of them that stay where they are would hide two numbers that do not.
    """
    moved = zip(fitted.parameters[:machine_count], fitted.z[:machine_count], strict=True)
    return [(n.name, abs(float(z))) for n, z in moved if not belongs_to_recording(n.name)]


def implausible(fitted: Fit, machine_count: int | None = None) -> bool:
    """Tell whether the file's numbers moved further than their uncertainties make likely."""
    moved = moved_numbers(fitted, machine_count)
    return sum(z**2 for _, z in moved) > SETTINGS.implausible * len(moved)


def with_a_plausible(contenders: Sequence[Hypothesis], ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Add the likeliest hypothesis with plausible numbers of the file to the contenders, if none of them has.

    An effect that is a number of the file, as a belt's stiffness is, can be had by moving that number alone. Then
    something small beside it fits better than the effect does before it is fitted well.
    """
    held = next((h for h in ranked if h.plausible), None)
    return list(contenders) if held is None or any(h.plausible for h in contenders) else [*contenders, held]


def prefer_plausible(best: Hypothesis, tried: Sequence[Hypothesis], little: float) -> Hypothesis:
    """Prefer a hypothesis with plausible numbers of the file that leaves but little of the discrepancy.

    One without would be rejected for it, and nothing would be named.
    """
    held = [h for h in tried if h.plausible and h.discrepancy < little]
    return best if best.plausible else min(held, key=lambda h: h.fit.evidence, default=best)


# ---- what is left --------------------------------------------------------------------------------


def incomplete(estimation: EstimationProblem, h: Hypothesis) -> bool:
    """Tell whether a discrepancy is left somewhere, or implausible parameters were needed to close it."""
    return leaves_excess(estimation, h.fit) or not h.plausible


def leaves_excess(estimation: EstimationProblem, fitted: Fit) -> bool:
    """Tell whether the residual stands above the noise, altogether or in any observation, by more than chance may do.

    The mean square of n rows of noise is one, give or take √(2/n): a short window stands out by chance alone.
    """
    parts = [fitted.residual, *(fitted.residual[rows] for rows in estimation.whiten.rows)]
    chance = SETTINGS.chance_sd
    return any(float(r @ r) / len(r) - 1 > max(estimation.tolerance, chance * np.sqrt(2 / len(r))) for r in parts)


# ---- parsimony -----------------------------------------------------------------------------------


def simplest(best: Hypothesis, tried: Sequence[Hypothesis], candidates: Sequence[Candidate]) -> Hypothesis:
    """Prefer fewer effects, or fewer parameters, where more are not significant."""
    fewer = [h for h in tried if _smaller(h, best, candidates)]
    return next((h for h in likeliest(fewer) if not significant(best.fit, h.fit)), best)


def smaller_rivals(best: Hypothesis, tried: Sequence[Hypothesis], candidates: Sequence[Candidate]) -> list[Hypothesis]:
    """List hypotheses of other effects, as many, with fewer parameters, that leave as little; the likeliest first."""
    others = [h for h in tried if h.names != best.names and len(h.effects) == len(best.effects)]
    fewer = [h for h in others if _smaller(h, best, candidates)]
    return likeliest([h for h in fewer if h.discrepancy < best.discrepancy + SETTINGS.exists])


def _smaller(h: Hypothesis, best: Hypothesis, candidates: Sequence[Candidate]) -> bool:
    if h.names == best.names:
        return len(h.fit.parameters) < len(best.fit.parameters)
    if len(h.effects) == len(best.effects):
        return _needed(h, candidates) < _needed(best, candidates)
    return set(h.names) < set(best.names)


def _needed(h: Hypothesis, candidates: Sequence[Candidate]) -> int:
    """Count the parameters without which there are no such effects.

    Of two effects that need as many, the likelier one is better: how far the shape of either was set free is no
    reason to prefer the other.
    """
    return sum(len(c.parameters) for c in candidates if c.name in h.names)


# ---- messages ------------------------------------------------------------------------------------


def log_fit(h: Hypothesis, progress: Progress, note: str = "") -> Hypothesis:
    """Report a hypothesis, and return it."""
    times = float(np.sqrt(max(1.0 + h.discrepancy, 0.0)))  # rms
    progress(f"{_joined(h.effects)}{note}: the error that is left is {times:.4g} times the noise")
    return h


def log_try(effects: Sequence[Candidate], progress: Progress, note: str = "") -> None:
    """Report what is being fitted."""
    progress(Now(f"fitting {_joined(effects)}{note}"))


def _joined(effects: Sequence[Candidate]) -> str:
    return " + ".join(c.name for c in effects)
