"""What a job found, as the page shows it: the answer that its verb prints with `--json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

COMMANDS = ("Look at it: ", "Then: ", "To search for it: ")  # next steps that are for the command line only
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


def answer_of(kind: str, result: Mapping[str, Any]) -> Answer:
    """Return what the page shows of one job."""
    if not (told := result.get("answer")):
        return Answer()
    steps = [each for each in told["next_steps"] if not each.startswith(COMMANDS)]
    drop = DROPS.get("plan" if kind == "excite" else kind)
    return Answer(told["headline"], told["facts"], told["warnings"], [*steps, *([drop] if drop else [])])
