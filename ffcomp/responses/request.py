"""What `ffcomp frf` can be asked to do, declared once for the command line and for Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from ffcomp.errors import RequestError
from ffcomp.options import MACHINE_NAME, number_pair
from ffcomp.request import ADVANCED, MACHINE, MachineLike, Option, Request

if TYPE_CHECKING:
    from models.arrays import FloatArray
else:
    FloatArray = object

MOST_LINES = 100_000  # of one response: more is a slip of the finger
Position = tuple[float, float]


def parse_positions(texts: Sequence[str]) -> tuple[Position, ...]:
    """Read positions `X,Y` in mm."""
    return tuple(number_pair("--at", text, ", in mm") for text in texts)


@dataclass(frozen=True)
class FrfRequest(Request):
    """Frequency responses of the linear model."""

    machine: Annotated[MachineLike, MACHINE_NAME]
    positions_mm: Annotated[
        Sequence[Position],
        Option(
            "Position, mm; default: middle. May be repeated.",
            MACHINE,
            "--at",
            metavar="X,Y",
            parse=parse_positions,
            repeated=True,
        ),
    ] = ()
    of: Annotated[
        Literal["carriage", "nozzle", "acceleration", "carriage-alone", "effector-alone"] | None,
        Option(
            "Output: carriage (default), nozzle, acceleration (of the nozzle), carriage-alone (sub-model 1, without "
            "the effector) or effector-alone (sub-model 2, force on the free effector).",
            MACHINE,
            metavar="OUTPUT",
        ),
    ] = None
    per: Annotated[
        Literal["carriage", "nozzle"] | None,
        Option("Input: carriage or nozzle. Default: as --of.", MACHINE, metavar="INPUT"),
    ] = None
    measured: Annotated[
        tuple[Path, ...],
        Option("Measured responses (CSV, UFF) to compare with. May be repeated.", MACHINE, metavar="FILE"),
    ] = ()
    lowest_hz: Annotated[
        float | None, Option("Lowest frequency. Default: one step.", ADVANCED, metavar="HZ", low=0.0)
    ] = None
    highest_hz: Annotated[float, Option("Highest frequency.", ADVANCED, metavar="HZ", low=1.0)] = 200.0
    step_hz: Annotated[float, Option("Frequency step.", ADVANCED, metavar="HZ", low=0.01)] = 0.5
    frequency_hz: Annotated[FloatArray | None, "(k,) array, Hz; None: from the lowest to the highest in steps."] = None

    @property
    def start_hz(self) -> float:
        """The lowest frequency."""
        return self.step_hz if self.lowest_hz is None else self.lowest_hz

    def check(self) -> None:
        """Check the frequencies."""
        if self.start_hz > self.highest_hz:
            raise RequestError(f"--lowest-hz {self.start_hz:g} lies above --highest-hz {self.highest_hz:g}.")
        if (self.highest_hz - self.start_hz) / self.step_hz > MOST_LINES:
            raise RequestError(f"--step-hz {self.step_hz:g}: more than {MOST_LINES} frequencies; take a larger step.")
