"""The finding of a diagnosis and the steps to take, in sentences: one text for terminal, JSON and report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ffcomp.diagnosis.noise import ABOVE
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.diagnosis.words import digits, joined, most_of, percent
from models.effects.catalogue import CATALOGUE

TOWERS, STRAIGHT = ("tower A", "tower B", "tower C"), ("axis X", "axis Y", "axis Z")
FEW = 4  # numbers or files in one sentence
COMPARE = "Compare the better machine file (-o better.toml) with new runs (ffcomp gap)."


def summary_sentences(result: DiagnosisResult) -> list[str]:
    """Return what speaks against the answer, the finding, then what it rests on and what limits it."""
    worse = [
        f"{one.recording} is {percent(filed)} off with the original file and {percent(after)} with the effects"
        for one in result.search.others
        for filed, after in [one.nrms]
        if after > filed
    ]
    against = [f"Does not hold for other motions: where only the others were fitted, {joined(worse)}."] if worse else []
    if lost := [Path(each).name for each in result.search.lost]:
        against.append(
            f"Nothing is said of {joined(lost)}: there every simulation is further off than standing still. "
            "Record softer motions, and others."
        )
    return [*against, *_finding(result), *_limits(result)]


def _finding(result: DiagnosisResult) -> Iterator[str]:
    gap, most, nearest = result.gap, result.dominant, result.refused
    size = f"{percent(gap.before)} of {_compared(result)} (noise {percent(gap.noise)})"
    left, explained, effects = percent(gap.after), most_of(gap.explained), joined(list(result.effects))
    unproven = joined(result.unproven[:FEW])
    match result.search.finding:
        case "effects":
            names = joined([_in_family(name) for name in result.effects])
            yield f"The gap of {size} shrinks to {left} with {names}: it explains {explained} of it."
            yield _elsewhere(result)
            yield from _open_numbers(result)
            if unproven:
                yield f"It is unproven at {unproven}, where little of the gap is."
            yield from _beyond(result)
            yield from _file_off(result)
        case "dominant" if most is not None:
            of, name = f"the gap in {most.signal}" if most.signal else "it", _in_family(most.effect.name)
            yield (
                f"There is a gap of {size}. Where it was not fitted to, {most_of(most.explained)} of {of} is {name}, "
                "by the amplitude averaged over frequency."
            )
            rest = f"A rest of {left} of {_compared(result)} stays, which nothing known explains"
            yield f"{rest}: {'; '.join(nearest.because)}." if nearest is not None else f"{rest}."
            if most.rivals:
                shares = [f"{joined(names)} would explain {percent(max(share, 0.0))}" for names, share in most.rivals]
                yield f"Of other effects {joined(shares)} there."
            yield from _open_numbers(result)
            yield from _beyond(result)
        case "nothing":
            off = "numbers of the file that are off" if result.beyond else "retuning within the stated uncertainties"
            yield f"Nothing is missing: the gap of {size} is noise, or {off}."
            yield from _beyond(result)
            if result.mends:
                there = _elsewhere(result)
                numbers = f"{len(result.retuned)} of the file's numbers retuned"
                yield f"With {numbers}, {left} are left; {there[0].lower()}{there[1:]}"
        case "cannot_tell" if gap.noise > SETTINGS.loud_noise:
            yield (
                f"Cannot tell: the noise is {percent(gap.noise)} of the signals, and may hide a missing effect. Record "
                "louder motions, or fasten the sensor better, and repeat each."
            )
        case "cannot_tell":
            yield (
                f"Cannot tell: the repeats differ by {percent(gap.noise)} of the signals, but only {left} are left "
                "after retuning, so they differ by more than noise. Check that repeats are of one motion, on one clock."
            )
        case "recording" if result.search.fault is not None:
            yield f"The recordings are at fault: {result.search.fault.sentence()}"
        case "unproven" if nearest is not None:
            where = f"; unproven at {unproven}" if unproven else ""
            yield (
                f"There is a gap of {size}; {explained} of it is explained by {effects}{where}. It is not named "
                f"because {'; '.join(nearest.because)}."
            )
            yield _elsewhere(result)
            yield from _file_off(result)
        case _:
            yield f"There is a gap of {size}, and nothing known explains it."
            if nearest is not None:
                because = "; ".join(nearest.because)
                yield f"Nearest: {effects}, which explains {explained} of it; refused because {because}."
            yield from _file_off(result)


def _compared(result: DiagnosisResult) -> str:
    return "the drive's forces" if result.problem.forces else "the signals"


def _in_family(name: str) -> str:
    """Return an effect by its family, then its law: `dry friction that falls with speed, stribeck_friction`."""
    family = CATALOGUE[name].family
    return f"{family}, {name}" if family else name


def _open_numbers(result: DiagnosisResult) -> Iterator[str]:
    """Say which numbers these recordings leave open."""
    if numbers := result.undetermined:
        yield f"These recordings do not determine {joined(numbers)}: any value near the end of its range fits as well."


def _elsewhere(result: DiagnosisResult) -> str:
    """Say what is explained where it was not fitted, and what it was not tested on."""
    gap, noise, (before, after) = result.gap, percent(result.gap.noise), result.gap.elsewhere
    if before <= gap.noise:  # there is no share of what does not stand above the noise
        shrunk = f"no gap stands above the noise of {noise} there, so this proves nothing"
    elif after <= gap.noise:
        shrunk = f"the residual does not stand above the noise of {noise}"
    else:
        shrunk = f"it explains {most_of(gap.explained_elsewhere)} of the gap there"
    numbers = f"{_compared(result)} were {percent(before)} off and are {percent(after)} off: {shrunk}"
    tested = f"it was not fitted to, one after the other, {numbers}"
    match gap.left_out:
        case "places":
            return f"At places {tested}."
        case "windows":
            return f"In windows of time {tested}."
        case "experiments":
            second = "record at a second place, at least 20 mm away"
            return f"One place only: not tested elsewhere. In experiments {tested}; {second}."
        case _:
            return "One experiment only: not tested elsewhere. Record other motions, at places at least 20 mm apart."


def _file_off(result: DiagnosisResult) -> Iterator[str]:
    """Say which of the file's own numbers would explain as much if they were wrong."""
    off = [f"{key} by {100 * (x.fitted / x.filed - 1):+.0f} %" for key, x in list(result.file_off.items())[:FEW]]
    if off:
        weigh = "Measure one of them by itself, and" if result.gap.left_out == "windows" else "Weigh what moves, and"
        yield (
            f"Or the machine file's own numbers are off: {joined(off)} would explain as much. {weigh} state in the "
            "file's [uncertainty] how well its numbers are known."
        )


def _beyond(result: DiagnosisResult) -> Iterator[str]:
    """Say which numbers of the file are as far off as retuning goes: another effect may be behind them."""
    numbers = result.retuned
    if each := [
        f"{name} by {times:.1f} times its uncertainty ({numbers[name].filed:.4g} in the file, "
        f"{numbers[name].fitted:.4g} fits)"
        for name, times in list(result.beyond.items())[:FEW]
    ]:
        yield (
            f"As far off as retuning goes is {joined(each)}: another effect may have changed it. Measure it again, or "
            "state in the file's [uncertainty] how well it is known."
        )


def _limits(result: DiagnosisResult) -> Iterator[str]:
    """Say what was compared, which motions or files are off, and what was not tried or is guessed."""
    if result.problem.forces:
        yield "The drive's force is compared with the one that the measured motion needs."
    if result.search.cut_short:
        yield (
            "The search ended at its budget of work, so not everything was tried: ffcomp diagnose --thorough goes on "
            "to the end, for as long as it takes."
        )
    if result.late_s:
        ranked = sorted(result.late_s.items(), key=lambda each: -abs(each[1]))
        files = [f"{name} lies {digits(1e3 * abs(s), 2)} ms {'late' if s > 0 else 'early'}" for name, s in ranked[:FEW]]
        more = f", and {len(ranked) - FEW} more" if len(ranked) > FEW else ""
        yield (
            f"Files do not lie on their command: {joined(files)}{more}. Their delays were fitted; join captures by the "
            "firmware's clock (ffcomp record join) to be surer."
        )
    if result.search.noise.origin == ABOVE:
        yield (
            f"The noise of {percent(result.gap.noise)} is a guess from above the model's band, because no motion was "
            "repeated: a smaller effect may be hidden in it."
        )


# ---- what to do ----------------------------------------------------------------------------------


def what_to_do(result: DiagnosisResult) -> list[str]:
    """Return steps in order: to the printer first, then to the file, then what to record."""
    separating, unproven = [each.sentence for each in result.separations], joined(result.unproven)
    match result.search.finding:
        case "dominant":
            return [
                _remedy(result, result.named[0]),
                "Diagnose again afterwards, or with the better machine file (-o better.toml), which contains this "
                "effect: the residual is then searched by itself.",
                *separating,
            ]
        case "effects":
            return [*(_remedy(result, name) for name in result.effects), *_afterwards(result), *separating]
        case "nothing":
            return [
                COMPARE if result.mends else "Nothing to mend, as far as these recordings show.",
                "Record again when prints change: other motions, speeds and places may show more.",
            ]
        case "cannot_tell" | "recording":
            return ["Record again as said above before anything is changed on the printer or in its file."]
    places = f"more places at least 20 mm apart{f', also near {unproven}' if unproven else ''}"
    return [
        *separating,
        "Do not add the nearest effect to the file by hand: it is wrong where it was not fitted.",
        "Look for something loose, rubbing, worn or bent where the gap is largest.",
        "Record other motions: slower and faster, shorter and longer, near rest and over the whole travel."
        if result.gap.left_out == "windows"
        else f"Record other motions, each twice, at {places}.",
    ]


def _remedy(result: DiagnosisResult, name: str) -> str:
    """Say how to mend an effect, and at which towers or axes first, where one stands out."""
    effect, kinematics = result.problem.catalogue[name], result.problem.machine.kinematics
    straight = kinematics.actuator_names if effect.of_motors else STRAIGHT
    names = TOWERS if kinematics.tower_directions else straight
    return effect.remedy.format(where=_first_of(names, result.effects[name]))


def _first_of(names: Sequence[str], table: Mapping[str, Any]) -> str:
    lists = [x for x in table.values() if isinstance(x, list) and len(x) == len(names)]
    if not lists:
        return ""
    sizes = [abs(float(x)) for x in lists[0]]
    high = [t for t, size in zip(names, sizes, strict=True) if size > 1.3 * sum(sizes) / len(sizes)]
    return f", first of {joined(high)}" if high else ""


def _afterwards(result: DiagnosisResult) -> Iterator[str]:
    gap = result.gap
    if gap.left_out == "windows":
        yield COMPARE
        return
    yield (
        "Until then, compensate with the better machine file (-o better.toml), and compare it with new recordings "
        "(ffcomp gap)."
    )
    if gap.left_out != "places":
        yield "Record the same motions at two more places, at least 20 mm apart, and diagnose again."
    elif result.unproven:
        yield f"Record louder motions at {joined(result.unproven)} and diagnose again."
