"""State the diagnosis in sentences for the printer's owner, the most important first."""

from __future__ import annotations

from collections.abc import Callable

from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.diagnose.sentences import elsewhere, file_off, finding_of, guessed, late, said, unproven
from ffcomp.report.diagnose.effects import in_words
from ffcomp.report.diagnose.inputs import ReportInput
from ffcomp.report.diagnose.standout import stands_out
from ffcomp.report.diagnose.words import evidence, joined, most_of, percent, times, title

MUCH_LESS = 0.7  # times the noise: its floor is wrong


def verdict(given: ReportInput) -> list[str]:
    """Return the finding, then its evidence."""
    by_finding: dict[str, Callable[[ReportInput], list[str]]] = {
        "effects": _effects,
        "nothing": _nothing,
        "unproven": _unproven,
        "unexplained": _unexplained,
    }
    found = given.outcome
    chosen = by_finding.get(finding_of(found))
    told = chosen(given) + late(found) if chosen else said(found)
    return [*told, *_invisible(found), *_noise(given)]


def _effects(given: ReportInput) -> list[str]:
    found = given.outcome
    named = joined([in_words(found, effect) for effect in found.effects])
    return [
        f"Missing from the machine file: {named}.",
        f"{_size(found)} With this added {percent(found.after.nrms)} are left: it explains "
        f"{most_of(found.explained)} of the gap.",
        elsewhere(found),
        *unproven(found),
        *file_off(found),
        *_where(given),
        f"{_sure(found)} {_confounded(found)}",
        _file(given),
    ]


def _nothing(given: ReportInput) -> list[str]:
    found = given.outcome
    moved = _count(len(found.retuned), "number")
    retuned = f" {moved} moved a little within what the file allows." if found.retuned else ""
    return [
        "Nothing is missing that these runs could show.",
        f"{_size(found)} What is left is noise, or retuning within the uncertainties that the file states.{retuned}",
        *guessed(found),
        *_nearest_promise(given),
        "Other motions, speeds and positions may still show something that these could not.",
    ]


def _unproven(given: ReportInput) -> list[str]:
    found = given.outcome
    nearest = joined([in_words(found, effect) for effect in found.effects])
    return [
        f"Most of the gap is explained, but not proven: {nearest}.",
        f"{_size(found)} With this added {percent(found.after.nrms)} are left: it explains "
        f"{most_of(found.explained)} of the gap. It is not named because {'; '.join(found.rejections)}.",
        elsewhere(found),
        *file_off(found),
        *_where(given),
    ]


def _unexplained(given: ReportInput) -> list[str]:
    found = given.outcome
    known = _count(len(given.picture.promises), "effect")
    nearest = joined(list(found.effects)) or "retuning alone"
    return [
        f"Something is missing from the machine file, and it is none of what ffcomp knows ({known}).",
        f"{_size(found)} That is a real gap, and it is not explained.",
        f"Nearest came {nearest}: it would explain {most_of(found.explained)} of the gap, and was "
        f"refused because {'; '.join(found.rejections)}.",
        *file_off(found),
        *_where(given),
    ]


def _size(found: DiagnosisResult) -> str:
    size = found.before
    ratio = size.nrms / size.noise_nrms
    more = f"{times(ratio)} as much as noise alone" if ratio > 1.05 else "as much as noise alone"
    if ratio < MUCH_LESS:
        more = "much less than what repeats differ by, so that is no noise"
    return (
        f"Simulated with the file as it is, the signals are {percent(size.nrms)} off, {more} "
        f"({percent(size.noise_nrms)})."
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
