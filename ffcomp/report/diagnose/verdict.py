"""What the diagnosis says, in sentences for who owns the printer; the most important first."""

from __future__ import annotations

from collections.abc import Callable

from ffcomp.diagnose.result import Outcome
from ffcomp.report.diagnose.effects import in_words
from ffcomp.report.diagnose.standout import stands_out
from ffcomp.report.diagnose.told import Told, explained, explained_elsewhere
from ffcomp.report.diagnose.words import evidence, joined, most_of, percent, times, title

LOOK = (
    "What to do: look for something loose, rubbing, worn or bent where the maps below show most of it; measure again "
    "with repeats, at more places and at several speeds; and do not add the nearest effect to the file by hand, it is "
    "wrong at places it was not fitted to."
)


def verdict(told: Told) -> list[str]:
    """The lead, then what it rests on."""
    by_verdict: dict[str, Callable[[Told], list[str]]] = {"effects": _effects, "none": _none, "unknown": _unknown}
    said = by_verdict[told.outcome.verdict](told)
    return [*said, *_invisible(told.outcome), *_noise(told)]


def _effects(told: Told) -> list[str]:
    found = told.outcome
    named = joined([in_words(found, effect) for effect in found.effects])
    return [
        f"Missing from the machine file: {named}.",
        f"{_size(found)} With this added {percent(found.after.nrms)} are left: it explains "
        f"{most_of(explained(found.before, found.after))} of the gap.",
        _elsewhere(told),
        *_where(told),
        f"{_sure(found)} {_rival(found)}",
        _file(told),
    ]


def _none(told: Told) -> list[str]:
    found = told.outcome
    moved = _count(len(found.retuned), "number")
    retuned = f" {moved} moved a little within what the file allows." if found.retuned else ""
    return [
        "Nothing is missing that these runs could show.",
        f"{_size(found)} What is left is noise, or retuning within the uncertainties that the file states.{retuned}",
        *_nearest_promise(told),
        "What to do: nothing, as far as these runs go. Other motions, speeds and places may still show something that "
        "these could not.",
    ]


def _unknown(told: Told) -> list[str]:
    found = told.outcome
    known = _count(len(told.picture.promises), "effect")
    nearest = joined(list(found.effects)) or "retuning alone"
    return [
        f"Something is missing from the machine file, and it is none of what ffcomp knows ({known}).",
        f"{_size(found)} That is a real gap, and it is not explained.",
        f"Nearest came {nearest}: it would explain {most_of(explained(found.before, found.after))} of the gap, and was "
        f"refused because {'; '.join(found.refused)}.",
        *_where(told),
        LOOK,
    ]


def _size(found: Outcome) -> str:
    size = found.before
    ratio = size.nrms / size.noise_nrms
    more = f"{times(ratio)} as much as noise alone" if ratio > 1.05 else "as much as noise alone"
    return (
        f"Simulated with the file as it is, the signals are {percent(size.nrms)} off, {more} "
        f"({percent(size.noise_nrms)})."
    )


def _elsewhere(told: Told) -> str:
    before, after = told.outcome.held_out
    return (
        "At places left out of the fit, one after the other, the signals were "
        f"{percent(before)} off and are {percent(after)} off: it explains "
        f"{most_of(explained_elsewhere(told.picture))} of the gap where it was never fitted."
    )


def _where(told: Told) -> list[str]:
    """The two things the excess depends on most."""
    said = [stands_out(split) for split in told.picture.splits if split.title in ("frequency", "place", "motion")]
    telling = [sentence for sentence in said if " of the excess lies " in sentence]
    return [f"Where it shows: {' '.join(telling)}"] if telling else []


def _sure(found: Outcome) -> str:
    least = min(found.confidence.values(), default=0.0)
    return f"{_odds(least)} (−2 ln Z: {evidence(found.gained)} better than retuning alone)."


def _odds(confidence: float) -> str:
    if confidence > 0.9999:
        return "Among the effects that ffcomp knows it is practically certain"
    return f"Among the effects that ffcomp knows it is {percent(confidence)} likely"


def _rival(found: Outcome) -> str:
    if not found.confusable_with:
        return "No other effect that these runs could show looks like it."
    names = joined([f"{name} ({title(name)})" for name, _ in found.confusable_with], "or")
    return f"It may be taken for {names}; what tells them apart stands below."


def _file(told: Told) -> str:
    if told.origin.written:
        return (
            f"The better machine file is {told.origin.written}. Compare it with new runs before you trust it: "
            f"ffcomp gap NEW-RUNS -m {told.origin.written}."
        )
    return "Give -o better.toml to have the machine file with this in it, then compare it with new runs (ffcomp gap)."


def _nearest_promise(told: Told) -> list[str]:
    seen = [p for p in told.picture.promises if p.visible]
    if not seen:
        return []
    first = max(seen, key=lambda p: p.gain)
    if first.gain < 0:
        return [f"No effect would have been worth its cost; {first.name} ({title(first.name)}) came nearest."]
    return [
        f"{first.name} ({title(first.name)}) came nearest: it promised {evidence(first.gain)} in −2 ln Z, too little "
        "to call it an effect."
    ]


def _invisible(found: Outcome) -> list[str]:
    if not found.invisible:
        return []
    return [f"These runs could not have shown: {joined(list(found.invisible))}. Nothing is said about them."]


def _noise(told: Told) -> list[str]:
    if told.picture.noise_from_repeats:
        return []
    return ["Nothing was measured twice, so the noise is a guess from above the model's band: weaker evidence."]


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' if n > 1 else ''}"
