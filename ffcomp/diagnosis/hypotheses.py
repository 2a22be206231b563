"""Hypotheses: some effects together with all parameters fitted, and how hypotheses are compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.diagnosis.fit import EstimationProblem, Fit, clipped
from ffcomp.diagnosis.problem import Candidate, Parameter, stem_of
from ffcomp.diagnosis.settings import SearchSettings
from ffcomp.diagnosis.words import times_noise
from ffcomp.numerics.stages import Now, Progress
from models.effects.catalogue import CATALOGUE

FILE_CHANGES = frozenset(name for name, effect in CATALOGUE.items() if effect.corrects_file)


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
    def causes(self) -> tuple[str, ...]:
        """What the effects are of, sorted: laws of one cause are one family."""
        return tuple(sorted(CATALOGUE[c.name].cause for c in self.effects))

    def may_leave(self, share: float, settings: SearchSettings) -> float:
        """Return the share of a discrepancy that its formulas may leave: hardly any where real machines know no other.

        Friction and play have many laws; a delay, a mass or a gain has one.
        """
        return min(share, settings.one_law) if all(CATALOGUE[c.name].one_law for c in self.effects) else share

    def is_trace_of(self, gap: float, settings: SearchSettings) -> bool:
        """Tell whether it leaves no more of a discrepancy without it than its formulas may."""
        return self.discrepancy < self.may_leave(settings.trace, settings) * gap

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
    def needed(self) -> int:
        """Number of the effects' parameters without which there is no such effect; others have a usual value."""
        return sum(p.is_needed for c in self.effects for p in CATALOGUE[c.name].parameters)

    @property
    def kinds(self) -> int:
        """Number of the effects' parameters that are fitted, those of several towers or axes counted as one."""
        return len({stem_of(n.name) for n in self.effect_parameters})

    @property
    def machine_parameters(self) -> tuple[Parameter, ...]:
        """The machine's parameters."""
        return self.fit.parameters[: self.machine_count]

    @property
    def effect_parameters(self) -> tuple[Parameter, ...]:
        """The effects' parameters."""
        return self.fit.parameters[self.machine_count :]

    def without(self, dropped: Candidate, file: Sequence[Parameter]) -> Hypothesis:
        """Leave one effect out, everything else as it stands; the numbers of the file that it replaced do what it did.

        Parameters
        ----------
        file : the machine's parameters, as the problem has them.
        """
        effects = tuple(c for c in self.effects if c.name != dropped.name)
        keep = [i for i, n in enumerate(self.fit.parameters) if n not in dropped.parameters]
        free = {n.name: n for n in file}
        machine = held([free.get(n.name, n) for n in self.machine_parameters], effects)
        parameters = (*machine, *(n for n in self.effect_parameters if n not in dropped.parameters))
        sizes = np.array([self.fit.z[self.fit.parameters.index(a)] for a in dropped.amplitudes])
        instead = {name: float(by_z @ sizes) for name, by_z in dropped.replaces.items()}
        z = [
            instead[n.name] / n.sd if n.name in instead else x
            for n, x in zip(parameters, self.fit.z[keep], strict=True)
        ]
        fitted = replace(
            self.fit, parameters=parameters, z=clipped(parameters, np.array(z)), jacobian=self.fit.jacobian[:, keep]
        )
        return Hypothesis(effects, fitted)


def held(machine: Sequence[Parameter], effects: Sequence[Candidate]) -> tuple[Parameter, ...]:
    """Hold the numbers that effects replace where the file has them: a fit that moves both ends anywhere between."""
    replaced = {name for c in effects for name in c.replaces}
    return tuple(replace(n, low=n.start, high=n.start) if n.name in replaced else n for n in machine)


def may_join(name: str, h: Hypothesis) -> bool:
    """Tell whether an effect is of none of these causes: friction has one law, however it is bent."""
    return CATALOGUE[name].cause not in h.causes


# ---- evidence ------------------------------------------------------------------------------------


def significant(larger: Fit, smaller: Fit, settings: SearchSettings, share: float) -> bool:
    """Tell whether the larger model is worth its cost, and removes more than this share of the discrepancy."""
    remains = max(smaller.cost - len(smaller.residual), 0.0)
    return larger.ahead_of(smaller) > settings.significant and smaller.cost - larger.cost > share * remains


def comparable(h: Hypothesis, best: Hypothesis, factor: float, settings: SearchSettings) -> bool:
    """Tell whether a hypothesis leaves at most `factor` times the discrepancy of the best."""
    least = settings.exists
    return h.discrepancy + least <= factor * max(best.discrepancy + least, least)


def likeliest(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Sort by evidence, the likeliest first."""
    scatter = min((h.fit.overdispersion for h in hypotheses), default=1.0)
    return sorted(hypotheses, key=lambda h: h.fit.evidence_at(scatter))


def distinct(ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Keep the first hypothesis of each set of effects."""
    return [h for i, h in enumerate(ranked) if h.names not in [before.names for before in ranked[:i]]]


def competing_with(
    best: Hypothesis, tried: Sequence[Hypothesis], settings: SearchSettings, share: float = 1.0, gap: float = 0.0
) -> list[Hypothesis]:
    """List hypotheses of other effects, as many, that are nearly as likely, or that explain all but a trace too.

    Parameters
    ----------
    share : of the data, on which all were fitted: all of it would set them apart that much further.
    gap : the discrepancy without any effect, of the noise. Where it is large, even a small error of an effect's shape
        is significant, and no effect has exactly our shape: one that leaves a hundredth of it cannot be ruled out.
    """
    others = [h for h in tried if h.names != best.names and len(h.effects) == len(best.effects)]
    nearly = 2 * settings.significant * share
    return [h for h in others if best.fit.ahead_of(h.fit) < nearly or h.is_trace_of(gap, settings)]


# ---- the remaining discrepancy -------------------------------------------------------------------


def leaves_excess(estimation: EstimationProblem, fitted: Fit) -> bool:
    """Tell whether the residual stands above the noise by more than chance may do.

    The mean square of n rows of noise is one, give or take √(2/n).
    """
    rows = len(fitted.residual)
    by_chance = estimation.settings.chance_sd * np.sqrt(2 / rows)
    return fitted.chi_squared / rows - 1 > max(estimation.tolerance, by_chance)


# ---- messages ------------------------------------------------------------------------------------


def log_fit(estimation: EstimationProblem, h: Hypothesis, progress: Progress, note: str = "") -> Hypothesis:
    """Report a hypothesis, add it to the trace, and return it."""
    numbers = [n.name for n in h.effect_parameters]
    estimation.trace.add("fit" + note, h.names, numbers, evidence=h.fit.evidence, left=h.discrepancy)
    progress(f"{_joined(h.effects)}{note}: {error_left(h.fit)}")
    return h


def error_left(fitted: Fit) -> str:
    """Say how large the error of a fit is, rms."""
    return f"the error that is left is {times_noise(fitted.discrepancy):.4g} times the noise"


def log_try(effects: Sequence[Candidate], progress: Progress, note: str = "") -> None:
    """Report what is being fitted."""
    progress(Now(f"fitting {_joined(effects)}{note}"))


def _joined(effects: Sequence[Candidate]) -> str:
    return " + ".join(c.name for c in effects)
