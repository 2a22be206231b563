"""What a diagnosis says, in sentences made of its numbers: for the text, the JSON's `said`, the report."""

from __future__ import annotations

from collections.abc import Callable

from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.diagnose.words import digits, joined, most_of, percent

FEW = 4  # numbers or files in one sentence
NOISY = 0.1  # of the signals


def said(found: DiagnosisResult) -> list[str]:
    """Return the finding, then what it rests on and what limits it."""
    by_finding: dict[str, Callable[[DiagnosisResult], list[str]]] = {
        "effects": _effects,
        "nothing": _nothing,
        "cannot_tell": _cannot_tell,
        "unproven": _unproven,
        "recording": lambda it: [f"The recordings are at fault: {it.fault}"],
    }
    return [*by_finding.get(finding_of(found), _unexplained)(found), *cut_short(found), *late(found)]


def finding_of(found: DiagnosisResult) -> str:
    """Return the finding; of a result made without one, what its verdict says."""
    return found.finding or {"effects": "effects", "none": "nothing"}.get(found.verdict, "unexplained")


def _gap(found: DiagnosisResult) -> str:
    return f"{percent(found.before.nrms)} of the signals (noise {percent(found.before.noise_nrms)})"


def _effects(found: DiagnosisResult) -> list[str]:
    names = joined(list(found.effects))
    return [
        f"The gap of {_gap(found)} shrinks to {percent(found.after.nrms)} with {names}: it explains "
        f"{most_of(found.explained)} of it.",
        elsewhere(found),
        *unproven(found),
        *file_off(found),
    ]


def elsewhere(found: DiagnosisResult) -> str:
    """Say what is explained where it was not fitted, and what it was not tested on."""
    before, after = (percent(x) for x in found.held_out)
    numbers = f"the signals were {before} off and are {after} off: {_shrunk_elsewhere(found)}"
    if found.left_out == "places":
        return f"At places it was not fitted to, one after the other, {numbers}."
    if found.left_out == "windows":
        return f"In windows of time it was not fitted to, one after the other, {numbers}."
    if found.left_out == "experiments":
        return (
            f"One place only: not tested elsewhere. In experiments it was not fitted to, one after the other, "
            f"{numbers}; record at a second place, at least 20 mm away."
        )
    return "One experiment only: not tested elsewhere. Record other motions, at places at least 20 mm apart."


def _shrunk_elsewhere(found: DiagnosisResult) -> str:
    """Say how much of the gap there is explained: no share of what does not stand above the noise."""
    noise = found.before.noise_nrms
    if found.held_out[0] <= noise:
        return f"no gap stands above the noise of {percent(noise)} there, so this proves nothing"
    if found.held_out[1] <= noise:
        return f"what is left does not stand above the noise of {percent(noise)}"
    return f"it explains {most_of(found.explained_elsewhere)} of the gap there"


def unproven(found: DiagnosisResult) -> list[str]:
    """Say where it is not explained."""
    if not found.unproven:
        return []
    return [f"It is unproven at {joined(list(found.unproven)[:FEW])}, where little of the gap is."]


def file_off(found: DiagnosisResult) -> list[str]:
    """Say which of the file's own numbers would explain as much if they were wrong."""
    if not found.file_off:
        return []
    off = [f"{key} by {100 * (to / start - 1):+.0f} %" for key, (start, to) in list(found.file_off.items())[:FEW]]
    return [
        f"Or the machine file's own numbers are off: {joined(off)} would explain as much. Weigh the effector and a "
        "carriage, and state in the file's [uncertainty] how well its numbers are known."
    ]


def _nothing(found: DiagnosisResult) -> list[str]:
    retuned = "numbers of the file that are off" if found.beyond else "retuning within the stated uncertainties"
    sentences = [f"Nothing is missing: the gap of {_gap(found)} is noise, or {retuned}.", *_beyond(found)]
    if found.mends:
        sentences.append(
            f"With {len(found.retuned)} of the file's numbers retuned, {percent(found.after.nrms)} are left; "
            + elsewhere(found)[0].lower()
            + elsewhere(found)[1:]
        )
    return [*sentences, *guessed(found)]


def _beyond(found: DiagnosisResult) -> list[str]:
    """Say which numbers of the file would be off by more than it says: an effect may be behind them."""
    if not found.beyond:
        return []
    each = [
        f"{name} by {times:.1f} times its uncertainty ({found.retuned[name][0]:.4g} in the file, "
        f"{found.retuned[name][1]:.4g} fits)"
        for name, times in list(found.beyond.items())[:FEW]
    ]
    return [
        f"Further off than the file says is {joined(each)}: measure that anew, for what changes it may be an effect, "
        "or state in the file's [uncertainty] how well it is known."
    ]


def guessed(found: DiagnosisResult) -> list[str]:
    """Say what a guessed noise may hide."""
    if not found.noise_guessed:
        return []
    return [
        f"The noise of {percent(found.before.noise_nrms)} is a guess, for no motion was repeated: an effect that does "
        "no more than that may be hidden in it."
    ]


def _cannot_tell(found: DiagnosisResult) -> list[str]:
    noise = found.before.noise_nrms
    if noise > NOISY:
        return [
            f"Cannot tell: the noise is {percent(noise)} of the signals, so what is missing may be hidden in it. "
            "Record louder motions, or fasten the sensor better, and repeat each."
        ]
    return [
        f"Cannot tell: the repeats differ by {percent(noise)} of the signals, but only {percent(found.after.nrms)} are "
        "left after retuning, so they differ by more than noise. Check that repeats are of one motion, on one clock."
    ]


def _unproven(found: DiagnosisResult) -> list[str]:
    where = f"; unproven at {joined(list(found.unproven)[:FEW])}" if found.unproven else ""
    return [
        f"There is a gap of {_gap(found)}; {most_of(found.explained)} of it is explained by "
        f"{joined(list(found.effects))}{where}. It is not named because {'; '.join(found.rejections)}.",
        elsewhere(found),
        *file_off(found),
    ]


def _unexplained(found: DiagnosisResult) -> list[str]:
    sentences = [f"There is a gap of {_gap(found)}, and nothing known explains it."]
    if found.rejections:
        sentences.append(
            f"Nearest: {joined(list(found.effects))}, which explains {most_of(found.explained)} of it; refused because "
            f"{'; '.join(found.rejections)}."
        )
    return [*sentences, *file_off(found)]


def cut_short(found: DiagnosisResult) -> list[str]:
    """Say that not everything was tried."""
    if not found.cut_short:
        return []
    return [
        "The search ended at its budget of work, so not everything was tried: ffcomp diagnose --thorough goes on to "
        "the end, for as long as it takes."
    ]


def late(found: DiagnosisResult) -> list[str]:
    """Say which files lie off their command."""
    if not found.late_s:
        return []
    ranked = sorted(found.late_s.items(), key=lambda each: -abs(each[1]))
    files = [f"{name} lies {digits(1e3 * abs(s), 2)} ms {'late' if s > 0 else 'early'}" for name, s in ranked[:FEW]]
    more = f", and {len(ranked) - FEW} more" if len(ranked) > FEW else ""
    return [
        f"Files do not lie on their command: {joined(files)}{more}. Their delays were fitted; join captures by the "
        "firmware's clock (ffcomp record join) to be surer."
    ]
