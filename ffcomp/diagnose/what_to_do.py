"""What to do to the printer, and what to record next, by what was result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ffcomp.diagnose.result import DiagnosisResult
from ffcomp.diagnose.sentences import finding_of
from ffcomp.diagnose.words import joined
from models.effects.catalogue import CATALOGUE

UNEVEN = 1.3  # times the mean of three: the one to begin with


def what_to_do(result: DiagnosisResult) -> list[str]:
    """Return steps in order: to the printer first, then to the file, then what to record."""
    finding, separating = finding_of(result), [each.sentence() for each in result.separations]
    if finding == "effects":
        return [*(_remedy(result, name) for name in result.effects), *_afterwards(result), *separating]
    if finding == "nothing":
        return ["Nothing to mend, as far as these recordings go. Record again when prints change."]
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
    names = result.names.belts if name.startswith(BELTS) else result.names.carriages
    return REMEDIES[name].format(where=_first_of(names, result.effects[name]))


def _first_of(names: Sequence[str], table: Mapping[str, Any]) -> str:
    """Name the towers or axes that stand out, where there is a value for each."""
    lists = [x for x in table.values() if isinstance(x, list) and len(x) == len(names)]
    if not lists:
        return ""
    sizes = [abs(float(x)) for x in lists[0]]
    high = [t for t, size in zip(names, sizes, strict=True) if size > UNEVEN * sum(sizes) / len(sizes)]
    return f", first of {joined(high)}" if high else ""


def _afterwards(result: DiagnosisResult) -> list[str]:
    if result.gap.left_out == "windows":
        return ["Compare the better machine file (-o better.toml) with new runs (ffcomp gap)."]
    steps = [
        "Until then, compensate with the better machine file (-o better.toml), and compare it with new recordings."
    ]
    if result.gap.left_out != "places":
        steps.append("Record the same motions at two more places, at least 20 mm apart, and diagnose again.")
    elif result.gap.unproven:
        steps.append(f"Record louder motions at {joined(list(result.gap.unproven))} and diagnose again.")
    return steps


def _at(result: DiagnosisResult) -> str:
    return f", also near {joined(list(result.gap.unproven))}" if result.gap.unproven else ""
