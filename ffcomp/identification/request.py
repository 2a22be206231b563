"""What `ffcomp identify` can be asked to do, declared once for the command line and for Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Literal

from ffcomp.errors import RequestError
from ffcomp.options import (
    CAPTURE_AXES,
    FIGURE,
    HIGHEST_FITTED,
    LOWEST_FITTED,
    MACHINE_FILE,
    MACHINE_NAME,
    MOVES_PLAN,
    RUNS,
    Files,
)
from ffcomp.request import ACCURACY, ADVANCED, FORCE, MACHINE, OUTPUT, Argument, MachineLike, Option, Request, silent

Method = Literal["direct", "stepwise"]
DATA = (
    "Frequency responses (CSV, UFF 58), recordings (CSV), captures of a plan, or Klipper's resonances_*.csv and "
    "raw_data_*.csv."
)
NEW_NAME = Option("Name of the new machine. Default: the output file's.", OUTPUT, metavar="NAME")


def known_numbers(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Parse KEY=VALUE±SD, also with +- ."""
    return dict(map(_known, texts))


def _known(text: str) -> tuple[str, tuple[float, float]]:
    key, _, number = text.partition("=")
    known, _, spread = number.replace("+-", "±").partition("±")
    try:
        value = float(known)
        sd = float(spread) if spread else 0.01 * abs(value)
        if not (isfinite(value) and 0.0 < sd < inf):
            raise ValueError
    except ValueError:
        raise RequestError(f"--known {text!r}: it reads KEY=VALUE±SD, with numbers, SD above zero.") from None
    return key.strip(), (value, sd)


@dataclass(frozen=True)
class IdentifyRequest(Request):
    """Measurements, and the machine whose file is fitted to them."""

    data: Annotated[Files, Argument(DATA, metavar="DATA...")]
    machine: Annotated[MachineLike, MACHINE_NAME]
    output: Annotated[Path | None, MACHINE_FILE] = None
    _: KW_ONLY
    plan: Annotated[Path | None, MOVES_PLAN] = None
    known: Annotated[
        Mapping[str, tuple[float, float]] | None,
        Option(
            "Known parameter, e.g. effector.total_mass_kg=0.651±0.001 from a kitchen scale. Any parameter of the "
            "machine file may be given. Without ± the standard deviation is one percent.",
            ACCURACY,
            metavar="KEY=VALUE±SD",
            parse=known_numbers,
            repeated=True,
        ),
    ] = None
    method: Annotated[
        Method,
        Option(
            "Method: direct, the output-error fit; stepwise, the paper's method, which needs all four setups.",
            ADVANCED,
            metavar="NAME",
        ),
    ] = "direct"
    name: Annotated[str | None, NEW_NAME] = None
    lowest_hz: Annotated[float, LOWEST_FITTED] = 2.0
    highest_hz: Annotated[float, HIGHEST_FITTED] = 400.0
    axes_map: Annotated[
        str, Option("The printer's axes in the accelerometer's own, e.g. x,-z,y.", MACHINE, metavar="X,Y,Z")
    ] = "x,y,z"
    axis: Annotated[
        tuple[str, ...],
        Option(
            "Excited axis of resonance tests whose file names do not state it: x, y, or a direction such as 1,-1 (a "
            "belt of a CoreXY machine) or 0.866,-0.5 (a tower of a delta). Once for all such files, or once for each.",
            MACHINE,
            metavar="AXIS",
        ),
    ] = ()
    column: Annotated[
        str | None,
        Option(
            "Column with the spectrum, for files with several columns and no header that names them.",
            MACHINE,
            metavar="NAME",
        ),
    ] = None
    rough: Annotated[
        bool, Option("Also write modes that leave more than 20 % of their measurement unexplained.", ACCURACY)
    ] = False
    progress: Annotated[Callable[[str], None], "Called with a sentence for each step of the work."] = silent

    def check(self) -> None:
        """Raise RequestError for an axis that is none."""
        from ffcomp.identification.resonance_tests import direction_of

        for axis in self.axis:
            try:
                direction_of(axis)
            except ValueError:
                rule = "it is x, y, z, or a direction of x and y such as 1,-1 or 0.866,-0.5"
                raise RequestError(f"--axis {axis!r}: {rule}.") from None


@dataclass(frozen=True, kw_only=True)
class FitRequest(IdentifyRequest):
    """Which files `ffcomp identify fit` fits, and how."""

    figure: Annotated[Path | None, FIGURE] = None
    force: Annotated[bool, FORCE] = False


@dataclass(frozen=True, kw_only=True)
class ScanRequest(Request):
    """Which pictures `ffcomp identify scan` reads, and what it writes."""

    pictures: Annotated[
        tuple[Path, ...],
        Argument("Scans or photos of one page: JPEG, PNG or TIFF. Several may overlap.", metavar="PICTURES..."),
    ]
    plan: Annotated[
        Path,
        Option("Plan (.json) that `record plan --for scan` wrote next to the page's G-code.", MACHINE, metavar="FILE"),
    ]
    machine: Annotated[str, MACHINE_NAME]
    output: Annotated[Path | None, MACHINE_FILE] = None
    name: Annotated[str | None, NEW_NAME] = None
    figure: Annotated[Path | None, FIGURE] = None
    force: Annotated[bool, FORCE] = False


@dataclass(frozen=True, kw_only=True)
class RingingRequest(Request):
    """Frequencies that somebody has read off a print, and the machine whose modes they are."""

    machine: Annotated[str, MACHINE_NAME]
    x_hz: Annotated[
        float | None,
        Option(
            "Frequency along x: wall speed × number of waves ÷ distance they span. Delta: any wall near the centre.",
            MACHINE,
            "--x-hz",
            metavar="HZ",
            low=3.0,
            high=200.0,
            label="Ringing along x, Hz",
        ),
    ] = None
    y_hz: Annotated[
        float | None,
        Option("Frequency along y.", MACHINE, "--y-hz", metavar="HZ", low=3.0, high=200.0, label="Ringing along y, Hz"),
    ] = None
    output: Annotated[Path, MACHINE_FILE]
    name: Annotated[str | None, NEW_NAME] = None
    force: Annotated[bool, FORCE] = False

    def check(self) -> None:
        """Raise RequestError without a frequency."""
        if self.x_hz is None and self.y_hz is None:
            raise RequestError("A frequency is needed: --x-hz, --y-hz, or both.")


@dataclass(frozen=True, kw_only=True)
class UpdateRequest(Request):
    """Which recordings of prints `ffcomp identify update` learns from, and what it writes."""

    data: Annotated[tuple[Path, ...], RUNS]
    machine: Annotated[str, MACHINE_NAME]
    output: Annotated[
        Path, Option("Machine file to write; it may be the one that is updated.", OUTPUT, "--output -o", metavar="FILE")
    ]
    plan: Annotated[Path | None, MOVES_PLAN] = None
    axes_map: Annotated[str | None, CAPTURE_AXES] = None
    drift: Annotated[
        float,
        Option(
            "Relative standard deviation of the drift of stiffnesses, masses and frequencies from print to print: "
            "belts age and spools empty. Dampings drift three times as much. The larger, the sooner old prints are "
            "forgotten.",
            ACCURACY,
            metavar="SHARE",
            low=0.0,
            high=0.2,
        ),
    ] = 0.005
    prints: Annotated[
        int, Option("Prints since the file was last updated, this one included.", ACCURACY, metavar="N", low=1)
    ] = 1
    history: Annotated[
        Path | None,
        Option(
            "Earlier updates; this one is added. Default: next to the machine file that is written, .updates.jsonl.",
            OUTPUT,
            metavar="FILE",
        ),
    ] = None
    force: Annotated[bool, FORCE] = False

    @property
    def history_file(self) -> Path:
        """The history."""
        return self.history or self.output.with_suffix(".updates.jsonl")
