"""State the diagnosis in sentences for the printer's owner, the most important first."""

from __future__ import annotations

from collections.abc import Callable

from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.report.diagnose.effects import in_words
from ffcomp.report.diagnose.inputs import ReportInput, explained, explained_elsewhere
from ffcomp.report.diagnose.standout import stands_out
from ffcomp.report.diagnose.words import evidence, joined, most_of, percent, times, title

LOOK = (
    "What to do: look for something loose, rubbing, worn or bent where the maps below show most of it; measure again "
    "with repeats, at more positions and at several speeds; and do not add the nearest effect to the file by hand, it "
    "is wrong at positions it was not fitted to."
)


def verdict(given: ReportInput) -> list[str]:
    """Return the finding, then its evidence."""
    by_verdict: dict[str, Callable[[ReportInput], list[str]]] = {
        "effects": _effects,
        "none": _none,
        "unknown": _unknown,
    }
    said = by_verdict[given.outcome.verdict](given)
    return [*said, *_invisible(given.outcome), *_noise(given)]


def _effects(given: ReportInput) -> list[str]:
    found = given.outcome
    named = joined([in_words(found, effect) for effect in found.effects])
    return [
        f"Missing from the machine file: {named}.",
        f"{_size(found)} With this added {percent(found.after.nrms)} are left: it explains "
        f"{most_of(explained(found.before, found.after))} of the gap.",
        _elsewhere(given),
        *_where(given),
        f"{_sure(found)} {_confounded(found)}",
        _file(given),
    ]


def _none(given: ReportInput) -> list[str]:
    found = given.outcome
    moved = _count(len(found.retuned), "number")
    retuned = f" {moved} moved a little within what the file allows." if found.retuned else ""
    return [
        "Nothing is missing that these runs could show.",
        f"{_size(found)} What is left is noise, or retuning within the uncertainties that the file states.{retuned}",
        *_nearest_promise(given),
        "What to do: nothing, as far as these runs go. Other motions, speeds and positions may still show something "
        "that these could not.",
    ]


def _unknown(given: ReportInput) -> list[str]:
    found = given.outcome
    known = _count(len(given.picture.promises), "effect")
    nearest = joined(list(found.effects)) or "retuning alone"
    return [
        f"Something is missing from the machine file, and it is none of what ffcomp knows ({known}).",
        f"{_size(found)} That is a real gap, and it is not explained.",
        f"Nearest came {nearest}: it would explain {most_of(explained(found.before, found.after))} of the gap, and was "
        f"refused because {'; '.join(found.rejections)}.",
        *_where(given),
        LOOK,
    ]


def _size(found: DiagnosisResult) -> str:
    size = found.before
    ratio = size.nrms / size.noise_nrms
    more = f"{times(ratio)} as much as noise alone" if ratio > 1.05 else "as much as noise alone"
    return (
        f"Simulated with the file as it is, the signals are {percent(size.nrms)} off, {more} "
        f"({percent(size.noise_nrms)})."
    )


def _elsewhere(given: ReportInput) -> str:
    before, after = given.outcome.held_out
    return (
        "At positions left out of the fit, one after the other, the signals were "
        f"{percent(before)} off and are {percent(after)} off: it explains "
        f"{most_of(explained_elsewhere(given.picture))} of the gap where it was never fitted."
    )


def _where(given: ReportInput) -> list[str]:
    """State what the excess depends on most."""
    said = [stands_out(split) for split in given.picture.splits if split.title in ("frequency", "place", "motion")]
    telling = [sentence for sentence in said if " of the excess lies " in sentence]
    return [f"Where it shows: {' '.join(telling)}"] if telling else []


def _sure(found: DiagnosisResult) -> str:
    least = min(found.confidence.values(), default=0.0)
    return f"{_odds(least)} (−2 ln Z: {evidence(found.gained)} better than retuning alone)."


def _odds(confidence: float) -> str:
    if confidence > 0.9999:
        return "Among the effects that ffcomp knows it is practically certain"
    return f"Among the effects that ffcomp knows it is {percent(confidence)} likely"


def _confounded(found: DiagnosisResult) -> str:
    if not found.confounded_with:
        return "No other effect that these runs could show looks like it."
    names = joined([f"{name} ({title(name)})" for name, _ in found.confounded_with], "or")
    return f"It may be taken for {names}; what tells them apart stands below."


def _file(given: ReportInput) -> str:
    if given.origin.written:
        return (
            f"The better machine file is {given.origin.written}. Compare it with new runs before you trust it: "
            f"ffcomp gap NEW-RUNS -m {given.origin.written}."
        )
    return "Give -o better.toml to have the machine file with this in it, then compare it with new runs (ffcomp gap)."


def _nearest_promise(given: ReportInput) -> list[str]:
    seen = [p for p in given.picture.promises if p.visible]
    if not seen:
        return []
    first = max(seen, key=lambda p: p.gain)
    if first.gain < 0:
        return [f"No effect would have been worth its cost; {first.name} ({title(first.name)}) came nearest."]
    return [
        f"{first.name} ({title(first.name)}) came nearest: it promised {evidence(first.gain)} in −2 ln Z, too little "
        "to call it an effect."
    ]


def _invisible(found: DiagnosisResult) -> list[str]:
    if not found.invisible:
        return []
    return [f"These runs could not have shown: {joined(list(found.invisible))}. Nothing is said about them."]


def _noise(given: ReportInput) -> list[str]:
    if given.picture.noise_from_repeats:
        return []
    return ["Nothing was measured twice, so the noise is a guess from above the model's band: weaker evidence."]


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'s' if n > 1 else ''}"
