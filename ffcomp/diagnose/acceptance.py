"""Acceptance tests: what a hypothesis must pass before its effects are named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ffcomp.diagnose.fit import Fit
from ffcomp.diagnose.held_out import LEFT, HeldOut
from ffcomp.diagnose.hypotheses import (
    OWN_NUMBERS,
    SIGNIFICANT,
    Hypothesis,
    discrepancy_of,
    implausible,
    misfit,
    moved_numbers,
    within_file,
)
from ffcomp.diagnose.intervals import superfluous
from ffcomp.identify.uncertainty import Estimate

MINOR = 0.05  # of all that was unexplained where it was left out: a place with less proves nothing against an effect
SEVERAL = 3  # changes of the file's own numbers at once, from which the file is taken for another machine's
WORSE = 1.5  # times the discrepancy without the effect: so much worse no place may become


def rejections(
    base: Fit, best: Hypothesis, held_out: Sequence[HeldOut], intervals: Mapping[str, Estimate], tolerance: float
) -> list[str]:
    """List the acceptance tests that a hypothesis fails, in words; none if it is accepted."""
    failed = []
    if (base.evidence - best.fit.evidence) / misfit(best.fit) < SIGNIFICANT:
        failed.append("it is not significantly better than retuning alone")
    if best.discrepancy > max(LEFT * discrepancy_of(base), tolerance):
        failed.append(f"{100 * best.discrepancy / discrepancy_of(base):.0f} % of the discrepancy is left")
    failed += [_unexplained(one, tolerance) for one in against(held_out, tolerance)]
    # where retuning alone explains the data as well, but by implausible parameters, there is nothing to gain
    if not held_out:
        failed.append("it was tested nowhere else: there is one experiment only")
    elif not implausible(base) and sum((one.before - one.after) * one.rows for one in held_out) < SIGNIFICANT:
        failed.append("data left out of the fit are simulated no better with it")
    failed += out_of_reach(best)
    if len(best.effects) == SEVERAL and set(best.names) <= OWN_NUMBERS:
        failed.append(
            "three of the machine file's own numbers would have to be far off at once, as in the file of another "
            "machine: measure this one (ffcomp identify)"
        )
    for candidate in best.effects:
        if superfluous(candidate, intervals):
            failed.append(f"the interval of {candidate.name} includes no effect at all")
    return failed


def out_of_reach(best: Hypothesis) -> list[str]:
    """Say which of the file's own numbers had to move furthest, if they had to move beyond what the file says."""
    if within_file(best):
        return []
    name, z = max(moved_numbers(best), key=lambda each: each[1])
    return [
        "with it the machine file's own numbers would have to be off by more than the file says, "
        f"{name} by {z:.1f} times its uncertainty"
    ]


def against(held_out: Sequence[HeldOut], tolerance: float) -> list[HeldOut]:
    """Return what was left out and speaks against a hypothesis.

    Shapes are never exactly ours: a place that holds a small part of all that has to be explained, and that it does
    not explain, says that it is unproven there, no more; unless it makes things worse there.
    """
    total = sum(max(one.before, 0.0) * one.rows for one in held_out)
    return [
        one
        for one in held_out
        if not one.explained(tolerance)
        and (one.after * one.rows > MINOR * total or one.after > max(WORSE * one.before, tolerance))
    ]


def unproven(held_out: Sequence[HeldOut], tolerance: float) -> list[HeldOut]:
    """Return what was left out and is not explained."""
    return [one for one in held_out if not one.explained(tolerance)]


def _unexplained(one: HeldOut, tolerance: float) -> str:
    if one.before <= tolerance:
        return f"at {one.label}, left out of the fit, it makes things worse"
    return f"at {one.label}, left out of the fit, {100 * one.after / one.before:.0f} % remains"
