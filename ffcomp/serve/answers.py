"""What a job found, as the page shows it: a sentence, facts, warnings; made of the JSON that the verbs print."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ffcomp.result import clock

JsonObject = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Answer:
    """What the page shows of one job."""

    lead: str = ""  # a sentence
    facts: Sequence[Sequence[str]] = ()  # pairs of a name and a value
    warnings: Sequence[str] = ()
    to_do: Sequence[str] = ()  # sentences
    kept: str = ""  # the name of one that was kept


def answer_of(kind: str, result: JsonObject) -> Answer:
    """Return what the page shows of one job."""
    if told := result.get("answer"):
        steps = [each for each in told["next_steps"] if not each.startswith("Look at it: ")]  # the page shows it
        return Answer(told["headline"], told["facts"], told["warnings"], steps)
    make = _ANSWERS.get(kind)
    return make(result) if make else Answer()


def _plan(result: JsonObject) -> Answer:
    repeats = f", each made {result['repeats']} times" if "repeats" in result else ""
    lead = f"{len(result['experiments'])} experiments, {clock(result['duration_s'])}{repeats}."
    facts = [["Firmware", str(result["flavor"])]]
    if "captures" in result:
        facts.append(["Captures", f"{len(result['captures'])} files will be written"])
    to_do = [
        "Put the accelerometer on the nozzle holder and nothing on the bed, heaters off; print moves.gcode, and stay "
        "beside it.",
        "Drop the captures that it writes (on Klipper: /tmp/*.csv on the printer's computer) below the moves.",
        *map(str, result.get("restores", [])),
    ]
    return Answer(lead, facts, list(result["warnings"]), to_do)


def _fit(result: JsonObject) -> Answer:
    numbers = [
        [key, _interval(each)] for key, each in (result.get("numbers") or {}).items() if isinstance(each, Mapping)
    ]
    axes = [fact for axis, each in (result.get("axes") or {}).items() for fact in _axis_facts(axis, each)]
    lead = "The machine file is fitted to the measurements." if result["output"] else "Nothing could be fitted."
    warnings = [*map(str, result["skipped"]), *map(str, result["advice"])]
    return Answer(lead, numbers + axes, warnings)


def _page(result: JsonObject) -> Answer:
    to_do = [
        "Print moves.gcode as it is: one layer of lines, the input shaper off.",
        "Scan it at 600 dpi or more, or photograph all of it straight from above, in even light, without flash.",
        "Drop the picture under the page.",
        *map(str, result.get("restores", [])),
    ]
    lead = f"A page of strokes, {clock(result['duration_s'])} to print."
    return Answer(lead, [["Firmware", str(result["flavor"])]], to_do=to_do)


def _update(result: JsonObject) -> Answer:
    numbers = [[key, _interval(each["after"])] for key, each in result["numbers"].items()]
    held = result["held_out"]
    lead = (
        f"Updated by {result['layers']} layers of the print. Where each was left out, {100 * held['after']:.2g} % of "
        f"its motion is left; with the file as it was {100 * held['before']:.2g} %."
    )
    kept = [f"The print does not tell {', '.join(result['kept'])}."] if result["kept"] else []
    return Answer(lead, numbers, kept)


def _axis_facts(axis: str, result: JsonObject) -> list[list[str]]:
    modes = [
        [f"{axis} axis", f"{_interval(mode['frequency_hz'])} Hz, damping ratio {_interval(mode['damping_ratio'])}"]
        for mode in result.get("modes", [])
    ]
    return [*modes, [f"{axis} axis", str(result.get("verdict", ""))]]


def _interval(estimate: JsonObject) -> str:
    value, low, high = (estimate.get(name) for name in ("value", "low", "high"))
    if not all(isinstance(each, int | float) for each in (value, low, high)):
        return str(value)
    return f"{value:.4g} ({low:.4g} to {high:.4g})"


def _import(result: JsonObject) -> Answer:
    if "values" not in result:  # a machine file that was checked
        return Answer(f"{result['machine']['name']} can be used.", warnings=list(result.get("notes", [])))
    origins = [each["how"] for each in result["values"].values()]
    assumed = origins.count("assumed")
    lead = f"{result['name']}: a {result['kinematics']} machine, from a {result['firmware']} configuration."
    facts = [["From the configuration", f"{len(origins) - assumed} values"], ["Assumed", f"{assumed} values"]]
    warnings = [f"{key} is missing: {why}" for key, why in result["missing"].items()]
    if assumed:
        like = f" as of {result['like']}" if result["like"] else ""
        warnings.append(f"How it vibrates is assumed{like}: no configuration tells it. See Know my machine.")
    return Answer(lead, facts, [*warnings, *map(str, result["notes"])])


_ANSWERS: dict[str, Callable[[JsonObject], Answer]] = {
    "plan": _plan,
    "excite": _plan,
    "fit": _fit,
    "scan": _fit,
    "ringing": _fit,
    "page": _page,
    "update": _update,
    "import": _import,
}
