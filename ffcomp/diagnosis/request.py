"""What `ffcomp gap` and `ffcomp diagnose` are to do: their options, declared once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ffcomp.diagnosis.settings import SETTINGS, SearchSettings
from ffcomp.options import CAPTURE_AXES, MACHINE_NAME, MOVES_PLAN, RUNS, Files
from ffcomp.request import ACCURACY, OUTPUT, MachineLike, Option, Request, silent

if TYPE_CHECKING:
    from ffcomp.diagnosis.problems import Recorded

    FilesOrRecordings = Files | Sequence[Recorded]
else:
    FilesOrRecordings = Files | tuple[object, ...]


@dataclass(frozen=True)
class GapRequest(Request):
    """Recordings, and the machine file whose simulation is compared with them."""

    recordings: Annotated[FilesOrRecordings, RUNS]
    machine: Annotated[MachineLike, MACHINE_NAME]
    plan: Annotated[Path | None, MOVES_PLAN] = None
    axes_map: Annotated[str | None, CAPTURE_AXES] = None
    progress: Annotated[Callable[[str], None], "Takes sentences on what is being done."] = silent


@dataclass(frozen=True)
class DiagnoseRequest(Request):
    """Recordings, and the machine file that may lack an effect."""

    recordings: Annotated[Files, RUNS]
    machine: Annotated[MachineLike, MACHINE_NAME]
    output: Annotated[
        Path | None,
        Option(
            "Improved machine file. Written if an effect is named or retuning closes the model discrepancy.",
            OUTPUT,
            "--output -o",
            metavar="FILE",
            writes="file",
        ),
    ] = None
    plan: Annotated[Path | None, MOVES_PLAN] = None
    axes_map: Annotated[str | None, CAPTURE_AXES] = None
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
            "Try everything, for as long as it takes. By default, a search ends at a budget of work, with a warning.",
            ACCURACY,
        ),
    ] = False
    trace: Annotated[
        Path | None,
        Option("Write every fit and decision of the search to this JSON file.", OUTPUT, metavar="FILE", writes="file"),
    ] = None
    settings: Annotated[SearchSettings, "How broad the search is, see `ffcomp.diagnosis.settings`."] = SETTINGS
    progress: Annotated[Callable[[str], None], "Takes sentences on what is being done."] = silent
