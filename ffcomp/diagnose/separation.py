"""A set of explanations that fit equally, and the recording that would tell them apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ffcomp.diagnose.words import digits, joined

ENOUGH = 0.3  # times the noise, rms: a thousand samples then differ by more than nine standard deviations
TWICE = 2.0  # times what differs in the given runs already: less is not worth another recording


@dataclass(frozen=True)
class Separation:
    """Two explanations, and where their predicted recordings differ most.

    Differences are the rms, in units of the noise, over the band of the diagnosis. What retuning within what the given
    runs allow would make up for is left out of `there`.
    """

    ours: tuple[str, ...]  # the effects of the best explanation
    other: tuple[str, ...]
    now: float  # the difference in the given runs
    there: float  # the difference in the recording that is proposed
    kind: str  # of `ffcomp record plan`
    position_mm: tuple[float, ...]
    command: str  # that plans the recording; "": the given runs tell them apart already
    otherwise: str = ""  # how to tell them apart by other means

    @property
    def tells(self) -> bool:
        """Tell whether the recording separates them."""
        return not self.command or self.there > max(ENOUGH, TWICE * self.now)

    def sentence(self) -> str:
        """Say what to record, and what it promises; or that no move does."""
        question = self._question()
        if not self.command:
            return (
                f"These runs {question} already, though the signatures are alike: the predictions, each at its best, "
                f"differ by {digits(self.now, 2)} times the noise."
            )
        if not self.tells:
            return (
                f"No move of ffcomp record plan can {question}: it shows {digits(self.there, 2)} times the noise at "
                f"most, beyond what retuning makes up for. {self.otherwise}".rstrip()
            )
        return (
            f"Record {self.command} and give its captures along with these runs, to {question}: there the predictions "
            f"differ by {digits(self.there, 2)} times the noise; in these runs by {digits(self.now, 2)}."
        )

    def _question(self) -> str:
        ours, theirs = _without(self.ours, self.other), _without(self.other, self.ours)
        if ours and theirs:
            return f"tell {joined(ours)} from {joined(theirs)}"
        return f"show whether {joined(ours or theirs)} acts as well"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON's entry of `separate`."""
        return {
            "effects": list(self.ours),
            "other": list(self.other),
            "difference_now": self.now,
            "difference_there": self.there,
            "separates": self.tells,
            "kind": self.kind,
            "position_mm": list(self.position_mm),
            "record": self.command,
            "said": self.sentence(),
        }


def _without(names: Sequence[str], others: Sequence[str]) -> list[str]:
    return [name for name in names if name not in others]
