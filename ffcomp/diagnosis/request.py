"""What `ffcomp gap` and `ffcomp diagnose` are to do: their options, declared once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ffcomp.request import ACCURACY, MACHINE, OUTPUT, Argument, Option, Request

if TYPE_CHECKING:
    from ffcomp.diagnosis.validation import Recorded
    from models.machine import Machine

    Files = Sequence[str | Path] | str | Path
    FilesOrRecordings = Files | Sequence[Recorded]
    MachineOrFile = str | Path | Machine
else:  # as the command line reads them
    Files = FilesOrRecordings = tuple[Path, ...]
    MachineOrFile = str

Runs = Argument(
    "Recordings (CSV), or captures with --plan. Names that differ in -1, -2, … only are repeats.", metavar="RUNS..."
)
MachineName = Option(
    "Machine: a name (see: ffcomp machines list) or the path of its file.", MACHINE, "--machine", "-m", metavar="NAME"
)
Plan = Option("Plan (.json) of captures, as `record plan` wrote it.", MACHINE, metavar="FILE")
AxesMap = Option(
    "The printer's axes in the accelerometer's own, e.g. x,-z,y. Default: found in the captures.",
    MACHINE,
    metavar="X,Y,Z",
)


def silent(sentence: str) -> None:
    """Report nothing."""


@dataclass(frozen=True)
class GapRequest(Request):
    """Recordings, and the machine file whose simulation is compared with them."""

    recordings: Annotated[FilesOrRecordings, Runs]
    machine: Annotated[MachineOrFile, MachineName]
    plan: Annotated[Path | None, Plan] = None
    axes_map: Annotated[str | None, AxesMap] = None
    progress: Callable[[str], None] = silent


@dataclass(frozen=True)
class DiagnoseRequest(Request):
    """Recordings, and the machine file that may lack an effect."""

    recordings: Annotated[Files, Runs]
    machine: Annotated[MachineOrFile, MachineName]
    output: Annotated[
        Path | None,
        Option(
            "Improved machine file. Written if an effect is named or retuning closes the model discrepancy.",
            OUTPUT,
            "--output",
            "-o",
            metavar="FILE",
        ),
    ] = None
    plan: Annotated[Path | None, Plan] = None
    axes_map: Annotated[str | None, AxesMap] = None
    without_repeats: Annotated[
        bool,
        Option(
            "Guess the noise where no experiment was repeated. The evidence is weaker.",
            ACCURACY,
            label="To find what is missing: nothing was repeated, guess the noise",
        ),
    ] = False
    thorough: Annotated[
        bool,
        Option(
            "Try everything, for as long as it takes. Else a search ends at a budget of work, and says so.", ACCURACY
        ),
    ] = False
    progress: Callable[[str], None] = silent
