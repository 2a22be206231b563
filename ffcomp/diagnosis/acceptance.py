"""Acceptance tests: what a hypothesis must pass before its effects are named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ffcomp.diagnosis.fit import Fit, superfluous
from ffcomp.diagnosis.held_out import HeldOut
from ffcomp.diagnosis.hypotheses import FILE_CHANGES, Hypothesis, implausible, moved_numbers
from ffcomp.diagnosis.problem import Parameter
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.identification.uncertainty import Estimate

AT_BOUND = 1e-6  # of a parameter's range: no nearer to its end is at it
NARROW = 0.1  # of a number: a range that leaves no more open determines it


def rejections(
    base: Fit,
    best: Hypothesis,
    held_out: Sequence[HeldOut],
    intervals: Mapping[str, Estimate],
    tolerance: float,
    signal: float = np.inf,
) -> list[str]:
    """List the acceptance tests that a hypothesis fails, in words; none if it is accepted.

    Parameters
    ----------
    signal : the discrepancy with nothing simulated at all; a worse one of the base is no measure.
    """
    failed, whole = [], min(base.discrepancy, signal)
    if (base.evidence - best.fit.evidence) / best.fit.misfit < SETTINGS.significant:
        failed.append("it is not significantly better than retuning alone")
    if best.discrepancy > max(SETTINGS.left * whole, tolerance):
        failed.append(f"{100 * best.discrepancy / whole:.0f} % of the discrepancy is left")
    failed += [_unexplained(one, tolerance) for one in contradicting(held_out, tolerance)]
    # where retuning alone explains the data as well, but by implausible parameters, there is nothing to gain
    if not held_out:
        failed.append("it was tested nowhere else: there is one experiment only")
    elif not implausible(base) and sum((one.before - one.after) * one.rows for one in held_out) < SETTINGS.significant:
        failed.append("data left out of the fit are simulated no better with it")
    failed += out_of_reach(best)
    if len(best.effects) == SETTINGS.most_effects and set(best.names) <= FILE_CHANGES:
        failed.append(
            "three of the machine file's own numbers would have to be far off at once, as in the file of another "
            "machine: measure this one (ffcomp identify)"
        )
    failed += unfounded(best, intervals)
    for candidate in best.effects:
        if superfluous(candidate, intervals):
            failed.append(f"the interval of {candidate.name} includes no effect at all")
    return failed


def out_of_reach(best: Hypothesis) -> list[str]:
    """Say which of the file's own numbers had to move furthest, if they had to move beyond what the file says."""
    if best.plausible:
        return []
    name, z = max(moved_numbers(best.fit, best.machine_count), key=lambda each: each[1])
    return [
        "with it the machine file's own numbers would have to be off by more than the file says, "
        f"{name} by {z:.1f} times its uncertainty"
    ]


def unfounded(best: Hypothesis, intervals: Mapping[str, Estimate]) -> list[str]:
    """Say of which effect nothing shows what makes it one: a ripple without a pitch, a mode without a frequency.

    A mode that swings far below the band is a mass that stays behind, and stands in for whatever asks for a gain.
    """
    return [
        f"{name.removeprefix('effects.')} is not determined, so nothing shows that it {does}"
        for does, key in (("repeats", ".pitch_mm"), ("swings", ".frequency_hz"))
        for name in [n for n in undetermined(best, intervals) if key in n][:1]
    ]


def undetermined(best: Hypothesis, intervals: Mapping[str, Estimate]) -> list[str]:
    """Return the effects' numbers that the data do not determine: at their bounds, or open over the whole range."""
    return [n.name for n in best.effect_parameters if n.low < n.high and _open(n, intervals[n.name])]


def _open(n: Parameter, interval: Estimate) -> bool:
    at_high = interval.value >= n.high - AT_BOUND * (n.high - max(n.low, -n.high)) if np.isfinite(n.high) else False
    at_low = n.low != 0.0 and np.isfinite(n.low) and interval.value <= n.low + AT_BOUND * abs(n.low)
    wide = n.high - n.low > NARROW * max(abs(n.low), abs(n.high))  # a line's pitch is sought close to where it was seen
    return at_high or at_low or (wide and interval.low <= n.low and interval.high >= n.high)


def contradicting(held_out: Sequence[HeldOut], tolerance: float) -> list[HeldOut]:
    """Return what was left out and contradicts a hypothesis.

    Shapes are never exactly ours: a place, or a window of little motion, that holds a small part of all that has to be
    explained, and that it does not explain, says that it is unproven there, no more; unless it makes things worse there
    by a good part of that.
    """
    minor = SETTINGS.minor_place * sum(max(one.before, 0.0) * one.rows for one in held_out)

    def weighs(one: HeldOut) -> bool:
        worse = one.after > max(SETTINGS.worse_place * one.before, tolerance)
        return one.after * one.rows > (minor / 4 if worse else minor)

    return [one for one in held_out if not one.explained(tolerance) and weighs(one)]


def unproven(held_out: Sequence[HeldOut], tolerance: float) -> list[HeldOut]:
    """Return what was left out and is not explained."""
    return [one for one in held_out if not one.explained(tolerance)]


def _unexplained(one: HeldOut, tolerance: float) -> str:
    if one.before <= tolerance:
        return f"at {one.label}, left out of the fit, it makes things worse"
    return f"at {one.label}, left out of the fit, {100 * one.after / one.before:.0f} % remains"
