"""The finding of a diagnosis and the steps to take, in sentences: one text for terminal, JSON and report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ffcomp.diagnosis.result import DiagnosisResult, Rest
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.diagnosis.words import digits, joined, most_of, percent
from models.effects.catalogue import CATALOGUE

FEW = 4  # numbers or files in one sentence


def summary_sentences(result: DiagnosisResult) -> list[str]:
    """Return the finding, then what it rests on and what limits it."""
    by_finding: dict[str, Callable[[DiagnosisResult], list[str]]] = {
        "effects": _effects,
        "nothing": _nothing,
        "cannot_tell": _cannot_tell,
        "dominant": _dominant,
        "unproven": _unproven,
        "recording": lambda result: [f"The recordings are at fault: {result.fault}"],
    }
    said = by_finding.get(result.finding, _unexplained)(result)
    sentences = [*worse_elsewhere(result), *said]
    if result.forces:
        sentences.append("The drive's force is compared with the one that the measured motion needs.")
    sentences += other_motions(result)
    if result.cut_short:
        sentences.append(
            "The search ended at its budget of work, so not everything was tried: ffcomp diagnose --thorough goes on "
            "to the end, for as long as it takes."
        )
    sentences += late_files(result)
    if result.gap.noise_guessed:
        sentences.append(
            f"The noise of {percent(result.gap.noise)} is a guess from above the model's band, because no motion was "
            "repeated: a smaller effect may be hidden in it."
        )
    return sentences


def _gap(result: DiagnosisResult) -> str:
    return f"{percent(result.gap.before.nrms)} of {result.compared} (noise {percent(result.gap.noise)})"


def in_family(name: str) -> str:
    """Return an effect by its family, then its law: `dry friction that falls with speed, stribeck_friction`."""
    family = CATALOGUE[name].family
    return f"{family}, {name}" if family else name


def _effects(result: DiagnosisResult) -> list[str]:
    names = joined([in_family(name) for name in result.effects])
    return [
        f"The gap of {_gap(result)} shrinks to {percent(result.gap.after.nrms)} with {names}: it explains "
        f"{most_of(result.gap.explained)} of it.",
        elsewhere(result),
        *open_numbers(result),
        *([f"It is unproven at {_unproven_at(result)}, where little of the gap is."] if result.gap.unproven else []),
        *file_off(result),
    ]


def _dominant(result: DiagnosisResult) -> list[str]:
    name, rest = result.named[0], result.rest
    assert rest is not None
    return [
        f"There is a gap of {_gap(result)}. Most of it is {in_family(name)}: where it was not fitted to, it explains "
        f"{most_of(rest.explained)} of the gap.",
        f"A rest of {percent(result.gap.after.nrms)} of {result.compared} stays, which nothing known explains: "
        f"{where_left(rest)}.",
        *instead(rest),
        *open_numbers(result),
    ]


def where_left(rest: Rest) -> str:
    """Say where a residual lies: frequencies, motion, place."""
    low, high, share = max(rest.left.bands, key=lambda band: band[2])
    place, _, there = max(rest.left.places, key=lambda each: each[2])
    where = f"in the window from {place[0]:g} s" if len(place) == 1 else f"at ({place[0]:.0f}, {place[1]:.0f}) mm"
    ways = rest.left.forwards
    parts = [
        f"{percent(share)} of it lies at {low:g} to {high:g} Hz",
        f"{percent(rest.left.near_reversals)} near reversals and at rest",
        *([f"{percent(max(ways, 1 - ways))} of the other while it moves {'for' if ways > 0.5 else 'back'}wards"]),
        f"{percent(there)} {where}",
    ]
    return joined(parts)


def instead(rest: Rest) -> list[str]:
    """Say what else would explain how much."""
    shares = [f"{joined(list(names))} would explain {percent(max(share, 0.0))}" for names, share in rest.rivals]
    return [f"Of other effects {joined(shares)} there."] if shares else []


def open_numbers(result: DiagnosisResult) -> list[str]:
    """Say which numbers these recordings leave open, and which have wide intervals because few motions scatter."""
    numbers, sentences = [name for name in result.undetermined if name not in result.scattered], []
    if numbers:
        sentences.append(
            f"These recordings do not determine {joined(numbers)}: any value near the end of its range fits as well."
        )
    if result.scattered:
        sentences.append(
            f"The {result.motions} motions give different values of {joined(list(result.scattered))}, and so few do "
            "not show how far other motions would scatter, so the interval is wide. Record more motions."
        )
    return sentences


def _unproven_at(result: DiagnosisResult) -> str:
    return joined(list(result.gap.unproven)[:FEW])


def elsewhere(result: DiagnosisResult) -> str:
    """Say what is explained where it was not fitted, and what it was not tested on."""
    before, after = (percent(x) for x in result.gap.elsewhere)
    numbers = f"{result.compared} were {before} off and are {after} off: {_shrunk_elsewhere(result)}"
    if result.gap.left_out == "places":
        return f"At places it was not fitted to, one after the other, {numbers}."
    if result.gap.left_out == "windows":
        return f"In windows of time it was not fitted to, one after the other, {numbers}."
    if result.gap.left_out == "experiments":
        return (
            f"One place only: not tested elsewhere. In experiments it was not fitted to, one after the other, "
            f"{numbers}; record at a second place, at least 20 mm away."
        )
    return "One experiment only: not tested elsewhere. Record other motions, at places at least 20 mm apart."


def _shrunk_elsewhere(result: DiagnosisResult) -> str:
    """Say how much of the gap there is explained: no share of what does not stand above the noise."""
    noise = result.gap.noise
    if result.gap.elsewhere[0] <= noise:
        return f"no gap stands above the noise of {percent(noise)} there, so this proves nothing"
    if result.gap.elsewhere[1] <= noise:
        return f"the residual does not stand above the noise of {percent(noise)}"
    return f"it explains {most_of(result.gap.explained_elsewhere)} of the gap there"


def file_off(result: DiagnosisResult) -> list[str]:
    """Say which of the file's own numbers would explain as much if they were wrong."""
    if not result.file.off:
        return []
    weigh = "Measure one of them by itself, and" if result.gap.left_out == "windows" else "Weigh what moves, and"
    off = [
        f"{key} by {100 * (each.fitted / each.filed - 1):+.0f} %" for key, each in list(result.file.off.items())[:FEW]
    ]
    return [
        f"Or the machine file's own numbers are off: {joined(off)} would explain as much. {weigh} state in the "
        "file's [uncertainty] how well its numbers are known."
    ]


def _nothing(result: DiagnosisResult) -> list[str]:
    retuned = "numbers of the file that are off" if result.file.beyond else "retuning within the stated uncertainties"
    sentences = [f"Nothing is missing: the gap of {_gap(result)} is noise, or {retuned}.", *_beyond(result)]
    if result.mends:
        sentences.append(
            f"With {len(result.file.retuned)} of the file's numbers retuned, {percent(result.gap.after.nrms)} are "
            f"left; {elsewhere(result)[0].lower()}{elsewhere(result)[1:]}"
        )
    return sentences


def _beyond(result: DiagnosisResult) -> list[str]:
    """Say which numbers of the file would be off by more than it says: an effect may be behind them."""
    if not result.file.beyond:
        return []
    each = [
        f"{name} by {times:.1f} times its uncertainty ({result.file.retuned[name].filed:.4g} in the file, "
        f"{result.file.retuned[name].fitted:.4g} fits)"
        for name, times in list(result.file.beyond.items())[:FEW]
    ]
    return [
        f"Further off than the file says is {joined(each)}: measure it again, because an effect may have changed it, "
        "or state in the file's [uncertainty] how well it is known."
    ]


def _cannot_tell(result: DiagnosisResult) -> list[str]:
    noise = result.gap.noise
    if noise > SETTINGS.loud_noise:
        return [
            f"Cannot tell: the noise is {percent(noise)} of the signals, and may hide a missing effect. "
            "Record louder motions, or fasten the sensor better, and repeat each."
        ]
    return [
        f"Cannot tell: the repeats differ by {percent(noise)} of the signals, but only "
        f"{percent(result.gap.after.nrms)} are left after retuning, so they differ by more than noise. "
        "Check that repeats are of one motion, on one clock."
    ]


def _unproven(result: DiagnosisResult) -> list[str]:
    where = f"; unproven at {_unproven_at(result)}" if result.gap.unproven else ""
    return [
        f"There is a gap of {_gap(result)}; {most_of(result.gap.explained)} of it is explained by "
        f"{joined(list(result.effects))}{where}. It is not named because {'; '.join(result.rejections)}.",
        elsewhere(result),
        *file_off(result),
    ]


def _unexplained(result: DiagnosisResult) -> list[str]:
    sentences = [f"There is a gap of {_gap(result)}, and nothing known explains it."]
    if result.rejections:
        sentences.append(
            f"Nearest: {joined(list(result.effects))}, which explains {most_of(result.gap.explained)} of it; refused "
            f"because {'; '.join(result.rejections)}."
        )
    return [*sentences, *file_off(result)]


def worse_elsewhere(result: DiagnosisResult) -> list[str]:
    """List first the motions where the answer is worse than the original file."""
    worse = [
        f"{one.name} is {percent(one.filed)} off with the original file and {percent(one.after)} with the effects"
        for one in result.others
        if one.worse
    ]
    return [f"Does not hold for other motions: where only the others were fitted, {joined(worse)}."] if worse else []


def other_motions(result: DiagnosisResult) -> list[str]:
    """Say which size of an effect is another in one motion."""
    return [
        f"In {one.name} {one.number} is {percent(abs(one.changed))} {'larger' if one.changed > 0 else 'smaller'} than "
        f"in the other recordings: with that number alone changed, {percent(one.refitted)} of {result.compared} are "
        f"left there and not {percent(one.after)}. It may change from recording to recording."
        for one in result.others
        if one.number
    ]


def late_files(result: DiagnosisResult) -> list[str]:
    """Say which files lie off their command."""
    if not result.late_s:
        return []
    ranked = sorted(result.late_s.items(), key=lambda each: -abs(each[1]))
    files = [f"{name} lies {digits(1e3 * abs(s), 2)} ms {'late' if s > 0 else 'early'}" for name, s in ranked[:FEW]]
    more = f", and {len(ranked) - FEW} more" if len(ranked) > FEW else ""
    return [
        f"Files do not lie on their command: {joined(files)}{more}. Their delays were fitted; join captures by the "
        "firmware's clock (ffcomp record join) to be surer."
    ]


# ---- what to do ----------------------------------------------------------------------------------


def what_to_do(result: DiagnosisResult) -> list[str]:
    """Return steps in order: to the printer first, then to the file, then what to record."""
    finding, separating = result.finding, [each.sentence for each in result.separations]
    if finding == "dominant":
        return [
            _remedy(result, result.named[0]),
            "Diagnose again afterwards, or with the better machine file (-o better.toml), which contains this effect: "
            "the residual is then searched by itself.",
            *separating,
        ]
    if finding == "effects":
        return [*(_remedy(result, name) for name in result.effects), *_afterwards(result), *separating]
    if finding == "nothing":
        compare = ["Compare the better machine file (-o better.toml) with new runs (ffcomp gap)."]
        return [
            *(compare if result.mends else ["Nothing to mend, as far as these recordings show."]),
            "Record again when prints change: other motions, speeds and places may show more.",
        ]
    if finding in ("cannot_tell", "recording"):
        return ["Record again as said above before anything is changed on the printer or in its file."]
    return [
        *separating,
        "Do not add the nearest effect to the file by hand: it is wrong where it was not fitted.",
        "Look for something loose, rubbing, worn or bent where the gap is largest.",
        f"Record other motions, each twice, at more places at least 20 mm apart{_at(result)}."
        if result.gap.left_out != "windows"
        else "Record other motions: slower and faster, shorter and longer, near rest and over the whole travel.",
    ]


def _remedy(result: DiagnosisResult, name: str) -> str:
    effect = result.names.catalogue[name]
    names = result.names.belts if effect.of_motors else result.names.carriages
    return effect.remedy.format(where=_first_of(names, result.effects[name]))


def _first_of(names: Sequence[str], table: Mapping[str, Any]) -> str:
    """Name the towers or axes that stand out, where there is a value for each."""
    lists = [x for x in table.values() if isinstance(x, list) and len(x) == len(names)]
    if not lists:
        return ""
    sizes = [abs(float(x)) for x in lists[0]]
    high = [t for t, size in zip(names, sizes, strict=True) if size > 1.3 * sum(sizes) / len(sizes)]
    return f", first of {joined(high)}" if high else ""


def _afterwards(result: DiagnosisResult) -> list[str]:
    if result.gap.left_out == "windows":
        return ["Compare the better machine file (-o better.toml) with new runs (ffcomp gap)."]
    steps = [
        "Until then, compensate with the original file: with the better one the sample print is predicted to be worse. "
        "Compare the better machine file (-o better.toml) with new recordings."
        if result.prints_worse
        else "Until then, compensate with the better machine file (-o better.toml), and compare it with new recordings "
        "(ffcomp gap)."
    ]
    if result.gap.left_out != "places":
        steps.append("Record the same motions at two more places, at least 20 mm apart, and diagnose again.")
    elif result.gap.unproven:
        steps.append(f"Record louder motions at {joined(list(result.gap.unproven))} and diagnose again.")
    return steps


def _at(result: DiagnosisResult) -> str:
    return f", also near {joined(list(result.gap.unproven))}" if result.gap.unproven else ""
