"""Answer the question of an owner: whether it is worth it, at the acceleration that this print has."""

from __future__ import annotations

from dataclasses import dataclass

from ffcomp.compare.result import Comparison, EqualQuality, Method
from ffcomp.report.compare.words import acceleration, contour_rms_um, fastest_shaper, nick, times, where_seen

WORTH, ALIKE = 2.0, 1.05  # times less error than the best shaper: below the first, a shaper is enough


@dataclass(frozen=True, slots=True)
class Answer:
    """One word, and why."""

    word: str  # Yes, Hardly, No
    why: str

    def __str__(self) -> str:
        return f"Worth it? {self.word}: {self.why}"


def answer(found: Comparison) -> Answer:
    """Weigh the compensated print against the best fixed shaper, which owners have for nothing."""
    own, best, none = (found.methods[name] for name in (found.compensated, found.best_fixed, "none"))
    left, theirs, before = (max(contour_rms_um(found, method), 1e-9) for method in (own, best, none))
    if not own.peaks.within_limits:
        return Answer("No", f"{_at(found)}ffcomp asks the carriages for more than the machine file allows.")
    if left >= theirs / ALIKE:
        as_good = "as good" if left <= ALIKE * theirs else "better"
        return Answer("No", f"{_at(found)}the best input shaper ({nick(best)}) is {as_good} on this print.")
    gain = f"{_at(found)}ffcomp leaves {times(theirs / left)} less error than the best input shaper ({nick(best)})"
    gain += f" and {times(before / left)} less than none, {where_seen(found)}.{_faster(found, own)}"
    if theirs < WORTH * left:
        return Answer("Hardly", f"{gain} The print is gentle: a shaper is enough.")
    return Answer("Yes", gain)


def _at(found: Comparison) -> str:
    if found.acceleration_mm_per_s2 is None:
        return ""
    return f"at your {acceleration(found.acceleration_mm_per_s2)} "


def _faster(found: Comparison, own: Method) -> str:
    """Say how much harder it may accelerate for the same quality."""
    quality, rival = own.equal_quality, fastest_shaper(found)
    theirs = None if rival is None else rival.equal_quality
    if quality is None or not quality.reached:
        return ""
    said = f" It keeps 99 % within {found.quality_bound_um:g} µm up to {_highest(quality)}"
    if theirs is None or rival is None:
        return f"{said}."
    if not theirs.reached:
        return f"{said}, which no shaper manages."
    return f"{said}, the fastest shaper ({nick(rival)}) up to {_highest(theirs)}."


def _highest(quality: EqualQuality) -> str:
    return f"{acceleration(quality.acceleration_mm_per_s2)}{' and more' if quality.capped else ''}"
