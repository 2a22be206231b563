"""What a job found, as the page shows it: the answer that its verb prints with `--json`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

VERBS = (  # "ffcomp leaves 2 µm" is no command
    "check|compare|compensate|diagnose|estimate|frf|gap|identify|log|machines|record|restore|serve|show|simulate|warmup"
)
COMMAND = re.compile(rf"\bffcomp (?:{VERBS})\b|(?<![\w-])--[a-z]")  # text that only the command line understands
MEASURES = re.compile(r"\bffcomp (?:record|identify) ")
MEASURE = "Measure the machine: see Know my machine."
DROPS = {
    "plan": "Drop the captures that it writes (on Klipper: /tmp/*.csv on the printer's computer) below the moves.",
    "page": "Drop the picture under the page.",
}


@dataclass(frozen=True, slots=True)
class Answer:
    """What the page shows of one job."""

    lead: str = ""  # a sentence
    facts: Sequence[Sequence[str]] = ()  # pairs of a name and a value
    warnings: Sequence[str] = ()
    to_do: Sequence[str] = ()  # sentences
    kept: str = ""  # the name of one that was kept
    code: str = ""  # settings to copy


def answer_of(kind: str, result: Mapping[str, Any]) -> Answer:
    """Return what the page shows of one job."""
    if not (told := result.get("answer")):
        return Answer()
    steps = [step for each in told["next_steps"] if (step := _without_commands(each))]
    if any(map(MEASURES.search, told["next_steps"])) and kind in ("compensate", "compare"):
        steps.append(MEASURE)
    drop = DROPS.get("plan" if kind == "excite" else kind)
    facts = [[name, _without_commands(value) or value] for name, value in told["facts"]]
    warnings = [_without_commands(each) or each for each in told["warnings"]]
    return Answer(told["headline"], facts, warnings, [*steps, *([drop] if drop else [])], code=_settings(result))


def _without_commands(text: str) -> str:
    """Return the sentences without a command or an option of the command line; empty: none is left."""
    return " ".join(each for each in re.split(r"(?<=[.!?]) (?=[A-Z])", text) if not COMMAND.search(each))


def _settings(result: Mapping[str, Any]) -> str:
    """Return the input shaper that a fit recommends, as Klipper's configuration has it."""
    if not result.get("shapers"):
        return ""
    from ffcomp.shapers.calibration import ShaperAdvice, klipper_block

    return klipper_block(tuple(ShaperAdvice(**each) for each in result["shapers"]))
