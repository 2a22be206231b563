"""Acceptance tests: what a hypothesis must pass before its effects are named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ffcomp.diagnosis.fit import EstimationProblem, Fit, believed, superfluous
from ffcomp.diagnosis.held_out import HeldOut, left_of
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.problem import Parameter, declared_parameter
from ffcomp.diagnosis.recording_clocks import belongs_to_recording
from ffcomp.diagnosis.words import percent
from ffcomp.identification.uncertainty import Estimate
from models.effects.catalogue import CATALOGUE

AT_BOUND = 1e-6  # of a parameter's range: no nearer to its end is at it
NARROW = 0.1  # of a number: a range that leaves no more open determines it


def rejections(
    estimation: EstimationProblem,
    best: Hypothesis,
    held_out: Sequence[HeldOut],
    intervals: Mapping[str, Estimate],
) -> list[str]:
    """List the acceptance tests that a hypothesis fails, in words; none if it is accepted.

    What counts is the prediction where it was left out of the fit, all places or windows together: one with little
    motion has little to explain, and weighs as little. Without the effect the likelihood ratio there is 1 on average,
    or less: an e-value. One above the number of families over `false_discoveries` limits the share of wrong names to
    that (e-BH: Wang & Ramdas, J. R. Stat. Soc. B 84, 2022); nearly, because the parts share most of their fits.
    """
    settings, failed = estimation.settings, list[str]()
    families = len({CATALOGUE[c.name].cause for c in estimation.problem.candidates})
    by_chance = 2 * np.log(families / settings.false_discoveries) * best.fit.overdispersion
    if not held_out:
        failed.append("it was tested nowhere else: there is one experiment only")
    else:
        rows, allowed = sum(one.rows for one in held_out), best.may_leave(settings.left, settings)
        gained = sum((one.before - one.after) * one.rows for one in held_out)
        left = sum(max(one.after, 0.0) * one.rows for one in held_out)
        if gained < by_chance:
            failed.append("data left out of the fit are simulated no better with it than by chance")
        elif left / rows > estimation.tolerance and (share := left_of(held_out)) > allowed:
            failed.append(f"{percent(share)} of the discrepancy is left where it was left out of the fit")
    unknown = [estimation.problem.quantities.key(n.name) for n in undetermined(best, intervals)]
    failed += [f"{key.removeprefix('effects.')} is not determined" for key in unknown]
    if retuned_too_far(best.fit, settings.chance_sd):
        failed.append("the file's numbers would have to be off further than their uncertainties together allow")
    for candidate in best.effects:
        if superfluous(candidate, intervals):
            failed.append(f"the interval of {candidate.name} includes no effect at all")
    return failed


def retuned_too_far(fitted: Fit, chance_sd: float) -> bool:
    """Tell whether the file's numbers were retuned further, all together, than chance puts them off.

    Where all of them must be off by a little, something else is missing, which they stand in for: their squares are χ².

    Parameters
    ----------
    chance_sd : standard deviations of a normal variable, that are as unlikely as what chance alone may show.
    """
    from scipy.special import chdtrc, ndtr

    own = believed(fitted.parameters) & [not belongs_to_recording(n.name) for n in fitted.parameters]
    return bool(chdtrc(max(int(own.sum()), 1), float(np.sum(fitted.z[own] ** 2))) < ndtr(-chance_sd))


def undetermined(best: Hypothesis, intervals: Mapping[str, Estimate]) -> list[Parameter]:
    """Return the effects' numbers that the data do not determine: open over their whole range, or shapes at its end.

    Others would do as well, or none at all; only numbers with a usual value may be open, for then they change nothing.
    A mode far below the band is a mass that stays behind, and stands in for whatever changes a gain; one that is damped
    as much as its limit creeps, as belts do. A centre may be anywhere.
    """
    shapes = {n.name for c in best.effects for n in c.shapes if not n.name.endswith("_centre_mm")}
    free = [n for n in best.effect_parameters if n.low < n.high]
    return [n for n in free if _open(n, intervals[n.name]) or (n.name in shapes and _at_end(n, intervals[n.name]))]


def _open(n: Parameter, interval: Estimate) -> bool:
    return _must_be_known(n) and interval.low <= n.low and interval.high >= n.high


def _must_be_known(n: Parameter) -> bool:
    """Tell whether there is no such effect without a number, and its range leaves it open."""
    wide = n.high - n.low > NARROW * max(abs(n.low), abs(n.high))  # a line's pitch is sought close to where it was seen
    return declared_parameter(n).is_needed and wide


def _at_end(n: Parameter, interval: Estimate) -> bool:
    declared = declared_parameter(n)
    low, high = (interval.low, interval.high) if _must_be_known(n) else (interval.value, interval.value)
    to_zero = n.low == 0.0 or (declared.logarithmic and declared.bounds[0] == 0.0)  # a value of its own: "never"
    at_low = not to_zero and np.isfinite(n.low) and low <= n.low + AT_BOUND * abs(n.low)
    return at_low or (np.isfinite(n.high) and high >= n.high - AT_BOUND * (n.high - max(n.low, -n.high)))
