"""The request of `simulate`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Annotated

from ffcomp.errors import RequestError
from ffcomp.options import FLAVOR, MACHINE_NAME, OFFSET, PLANT, PLATE, Offset
from ffcomp.request import ACCURACY, ADVANCED, OUTPUT, SPEED, Argument, MachineLike, Option, Request, silent

SIGNALS = ("acc", "pos")


def parse_signals(text: str) -> tuple[str, ...]:
    """Read the sensors of a recording, with commas between them."""
    return tuple(dict.fromkeys(text.split(",")))


@dataclass(frozen=True)
class SimulateRequest(Request):
    """A command to simulate: its machine file, the printer, and the part of the print."""

    file: Annotated[
        str | Path, Argument("Print (sliced or compensated) or step-timing archive (.npz).", metavar="FILE")
    ]
    machine: Annotated[MachineLike, MACHINE_NAME]
    plant: Annotated[MachineLike | None, PLANT] = None
    recording: Annotated[
        str | Path | None,
        Option("Write a recording (CSV) for ffcomp gap.", OUTPUT, "--output -o", metavar="FILE", writes="file"),
    ] = None
    rate_hz: Annotated[
        float,
        Option(
            "Sample rate of the evaluation and the recording.",
            ACCURACY,
            "--rate",
            metavar="HZ",
            low=800.0,
            high=25600.0,
        ),
    ] = 1600.0
    from_s: Annotated[
        float,
        Option(
            "Begin at this time of the command. A recording for ffcomp gap should begin at rest.",
            SPEED,
            "--from",
            metavar="S",
        ),
    ] = 0.0
    to_s: Annotated[float, Option("End at this time of the command. Default: the end.", SPEED, "--to", metavar="S")] = (
        inf
    )
    signals: Annotated[
        tuple[str, ...],
        Option(
            "Sensors in the recording: acc, pos or acc,pos.",
            OUTPUT,
            metavar="KINDS",
            parse=parse_signals,
            unset="acc,pos",
        ),
    ] = SIGNALS
    gravity: Annotated[bool, Option("Let the weight deflect the belts and the extruder's mount.", ADVANCED)] = True
    offset_mm: Annotated[Offset | None, OFFSET] = None
    flavor: Annotated[str, FLAVOR] = ""
    plate: Annotated[int | None, PLATE] = None
    progress: Annotated[Callable[[float], None], "Called with the print seconds done so far."] = silent

    def check(self) -> None:
        """Check times, sensors, and that nothing is written over the command."""
        if not 0.0 <= self.from_s < self.to_s:
            raise RequestError(
                f"--from {self.from_s:g} --to {self.to_s:g}: two times in s, the first not below 0, in order."
            )
        if not set(self.signals) <= set(SIGNALS):
            signals = ",".join(self.signals)
            raise RequestError(f"--signals {signals!r}: {', '.join(SIGNALS)}, or both with a comma between them.")
        if self.recording is not None and Path(self.recording).resolve() == Path(self.file).resolve():
            raise RequestError(f"-o {self.recording}: this is the command itself; the run needs a file of its own.")
