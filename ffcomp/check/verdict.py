"""What a comparison allows to be said: as last time, what changed, or that it cannot be told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.check.compare import AS_NOISE, Comparison, Explanation

EXPLAINED = 0.9  # of the change, by the part that is named
APART = 2.0  # times as much must be left by any other part
LEAST_LEFT = 0.01  # of the change: less is not to be relied on
SURE = 5.0  # standard deviations
TURNED_DEG, GAINED = 1.0, 0.02
LOUD = 0.1  # noise, as a share of the signal
SAME, CHANGED, UNKNOWN, SENSOR, CANNOT_TELL, FIRST = (
    "same",
    "changed",
    "unknown",
    "sensor",
    "cannot_tell",
    "first",
)


@dataclass(frozen=True)
class Verdict:
    """A finding and its sentence; the explanations that it rests on."""

    finding: str
    said: str
    named: tuple[Explanation, ...] = ()


def verdict(found: Comparison, last: str, axes_then: str, axes_now: str) -> Verdict:
    """Say what two checks show, the earlier one of the date `last`."""
    turned = (
        ""
        if axes_then == axes_now
        else (
            f"The accelerometer was turned since {last}: the printer's axes were {axes_then} of its own, and are "
            f"{axes_now} now. It is turned back for the comparison. "
        )
    )
    if found.times <= AS_NOISE:
        quiet = _quiet(found, last)
        if turned and quiet.finding == SAME:
            return Verdict(SENSOR, turned + f"Otherwise the printer moves as on {last}.")
        return Verdict(quiet.finding, turned + quiet.said, quiet.named)
    moved = _sensor(found)
    if moved is not None:
        return Verdict(SENSOR, turned + moved)
    told = _told(found, last)
    return Verdict(told.finding, turned + told.said, told.named)


def _differs(found: Comparison) -> str:
    return f"it differs by {found.size:.1%} of the signal, and noise would by {found.noise:.1%}"


def _quiet(found: Comparison, last: str) -> Verdict:
    """Judge a difference that looks like noise."""
    hidden = [each for each in found.explanations if each.part.worth is not None]
    loud = [each for each in hidden if abs(each.value) + 3.0 * each.sd > (each.part.worth or 0.0)]
    sure = [each for each in loud if abs(each.value) > SURE * each.sd]
    if found.noise > LOUD or loud:
        hint = f" Perhaps {sure[0].part.words(sure[0].value)}." if sure else ""
        return Verdict(
            CANNOT_TELL,
            f"Cannot tell whether the printer moves as on {last}: noise is {found.noise:.0%} of the signal.{hint} "
            "Tighten the accelerometer, stop fans and what else shakes, and check again.",
        )
    return Verdict(SAME, f"As on {last}: {_differs(found)}.")


def _sensor(found: Comparison) -> str | None:
    turned = found.turned
    others = max((each.share for each in found.explanations), default=0.0)
    if turned.share < EXPLAINED or turned.share <= others:
        return None
    if abs(turned.degrees) > TURNED_DEG and abs(turned.gain) <= GAINED:
        return (
            f"The accelerometer is turned by {abs(turned.degrees):.0f}° about the vertical since then: that explains "
            f"{min(turned.share, 1.0):.0%} of the change. Fasten it as it was, and check again."
        )
    if abs(turned.gain) > GAINED:
        more = "more" if turned.gain > 0 else "less"
        return (
            f"The accelerometer reads {abs(turned.gain):.0%} {more} of the same motion: that explains "
            f"{min(turned.share, 1.0):.0%} of the change. It is another one, or its range was set anew; the next check "
            "will be compared with this one."
        )
    return None


def _told(found: Comparison, last: str) -> Verdict:
    """Name the part that explains the change, or the parts that do so equally well."""
    changed = f"The printer has changed since {last}: {_differs(found)}."
    best = found.explanations[0] if found.explanations else None
    if best is None or best.share < EXPLAINED:
        return Verdict(UNKNOWN, f"{changed} No single part explains it, so it cannot be told here what changed.")
    # of a change that noise half hides, the shares themselves are uncertain
    unsure = max(LEAST_LEFT, 3.0 * float(np.sqrt(2.0 / found.rows)) / (found.times**2 - 1.0))
    left = max(1.0 - best.share, unsure)
    alike = [each for each in found.explanations[1:] if each.share >= EXPLAINED and 1.0 - each.share < APART * left]
    named = (best, *alike)
    words = ", or ".join(each.part.words(each.value) for each in named)
    unlike = " These, and some of each, cannot be told apart here." if alike else ""
    return Verdict(
        CHANGED,
        f"{changed} {words[0].upper()}{words[1:]}: that explains {min(best.share, 1.0):.0%} of it.{unlike}",
        named,
    )
