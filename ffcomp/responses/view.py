"""A selection of frequency responses: of the whole printer, of a carriage alone, or of the effector alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ffcomp.measurement.frf import AXES, CARRIAGES, FrequencyResponse
from models.vibration.base import Output

Of = Literal["carriage", "nozzle", "acceleration", "carriage-alone", "effector-alone"]
Per = Literal["carriage", "nozzle"]
Pair = tuple[int, int]  # row and column of a view

TITLES = {
    "carriage": "carriage position",
    "nozzle": "nozzle position",
    "acceleration": "nozzle acceleration",
    "carriage-alone": "One carriage on its belt, effector off: command to position",
    "effector-alone": "The effector by itself: force on the nozzle holder to its acceleration",
}


@dataclass(frozen=True)
class View:
    """Which responses: the output `of` the printer or a part, `per` command."""

    of: Of = "carriage"
    per: Per = "carriage"

    @property
    def depends_on_place(self) -> bool:
        """Whether the response differs over the bed."""
        return not self.of.endswith("-alone")

    @property
    def answering(self) -> Output:
        """The output of the whole printer; of a sub-model the carriages."""
        return self.of if self.of in ("nozzle", "acceleration") else "carriage"

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return {"carriage": tuple(CARRIAGES), "carriage-alone": ("carriage",)}.get(self.of, tuple(AXES))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the inputs, commanded or struck."""
        if not self.depends_on_place:
            return self.rows
        return tuple(CARRIAGES if self.per == "carriage" else AXES)

    @property
    def unit(self) -> str:
        """Unit of the response."""
        return {"acceleration": "1/s²", "effector-alone": "1/kg"}.get(self.of, "mm/mm")

    @property
    def title(self) -> str:
        """Heading for figures and tables."""
        return f"Commanded {self.per} to {TITLES[self.of]}" if self.depends_on_place else TITLES[self.of]

    @property
    def pairs(self) -> list[Pair]:
        """Shown by default: the response of each output to its own input."""
        if self.rows == self.columns:
            return [(i, i) for i in range(len(self.rows))]
        return [(i, k) for i in range(3) for k in range(3)]

    def pair(self, response: FrequencyResponse) -> Pair | None:
        """Return row and column of a measured response; None: it is not in this view."""
        own, answers, commanded = view_of(response), response.output[-1], response.input[-1]
        if self.of == "carriage-alone" and own.of == self.of:
            return 0, 0
        if self.of == "effector-alone" and own.of == self.of and answers == commanded:
            return AXES.index(answers), AXES.index(answers)
        nozzle = self.of in ("nozzle", "acceleration") and own.of == "nozzle"
        if response.input.startswith("cmd_") and own.per == self.per and (nozzle or own.of == self.of == "carriage"):
            return self.rows.index(answers), self.columns.index(commanded)
        return None

    def left_out(self, response: FrequencyResponse) -> str:
        """Say that a measured response is not in this view, and where it is."""
        what, own = f"{response.source}: {response.input} to {response.output}", view_of(response)
        if response.setup == "assembly" and not response.input.startswith("cmd_"):
            return f"{what} answers no command, so it is of no view here."
        per = f" --per {own.per}" if own.depends_on_place else ""
        return (
            f"{what} ({response.setup}) is not a response of this view (--of {self.of}); look at it with --of "
            f"{own.of}{per}."
        )


def view_of(response: FrequencyResponse) -> View:
    """Return the view that a measured response belongs to."""
    if response.setup != "assembly":
        return View("effector-alone" if response.setup == "effector" else "carriage-alone")
    answers, commanded = response.output[-1], response.input[-1]
    return View("carriage" if answers in CARRIAGES else "nozzle", "carriage" if commanded in CARRIAGES else "nozzle")
