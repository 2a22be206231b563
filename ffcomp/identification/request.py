"""What `ffcomp identify` can be asked to do, declared once for the command line and for Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from ffcomp.errors import RequestError
from ffcomp.options import FIGURE, FORCE, HIGHEST_FITTED, LOWEST_FITTED, MACHINE_FILE, MACHINE_NAME, MOVES_PLAN
from ffcomp.request import ACCURACY, ADVANCED, MACHINE, OUTPUT, Argument, Option, Request

Method = Literal["direct", "stepwise"]
DATA = (
    "Frequency responses (CSV, UFF 58), recordings (CSV), captures of a plan, or Klipper's resonances_*.csv and "
    "raw_data_*.csv."
)
Data = Annotated[tuple[Path, ...], Argument(DATA, metavar="DATA...")]


def known_numbers(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Parse KEY=VALUE±SD, also with +- ."""
    return dict(map(_known, texts))


def _known(text: str) -> tuple[str, tuple[float, float]]:
    key, _, number = text.partition("=")
    value, _, sd = number.replace("+-", "±").partition("±")
    try:
        return key.strip(), (float(value), float(sd) if sd else 0.01 * abs(float(value)))
    except ValueError:
        raise RequestError(f"--known {text!r}: it reads KEY=VALUE±SD, with numbers.") from None


@dataclass(frozen=True, kw_only=True)
class FitRequest(Request):
    """Which files `ffcomp identify fit` fits, and how."""

    data: Data
    machine: Annotated[str, MACHINE_NAME]
    output: Annotated[Path | None, MACHINE_FILE] = None
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
    name: Annotated[
        str | None, Option("Name of the new machine. Default: the output file's.", OUTPUT, metavar="NAME")
    ] = None
    figure: Annotated[Path | None, FIGURE] = None
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
            "Spectrum to be used of files with several columns, where their header does not say what these are.",
            MACHINE,
            metavar="NAME",
        ),
    ] = None
    rough: Annotated[
        bool, Option("Write modes too that leave more than 20 % of their measurement unexplained.", ACCURACY)
    ] = False
    force: Annotated[bool, FORCE] = False

    def check(self) -> None:
        """Raise RequestError for what is no axis, and rather than overwrite a file."""
        for axis in self.axis:
            _check_axis(axis)
        if self.output is not None and self.output.exists() and not self.force:
            raise RequestError(f"{self.output} exists already; give another --output, or --force.")


@dataclass(frozen=True, kw_only=True)
class DecoupleRequest(Request):
    """Which responses `ffcomp identify decouple` decouples."""

    data: Data
    machine: Annotated[str, MACHINE_NAME]
    lowest_hz: Annotated[float, LOWEST_FITTED] = 2.0
    highest_hz: Annotated[float, HIGHEST_FITTED] = 125.0
    as_json: Annotated[bool, Option("Print one JSON object on stdout.", OUTPUT, "--json")] = False


@dataclass(frozen=True, kw_only=True)
class ScanRequest(Request):
    """Which pictures `ffcomp identify scan` reads, and what it writes."""

    pictures: Annotated[
        tuple[Path, ...],
        Argument("Scans or photos of one page: JPEG, PNG or TIFF. Several may overlap.", metavar="PICTURES..."),
    ]
    plan: Annotated[
        Path,
        Option("Plan (.json) that `record plan --for scan` wrote beside the page's G-code.", MACHINE, metavar="FILE"),
    ]
    machine: Annotated[str, MACHINE_NAME]
    output: Annotated[Path | None, MACHINE_FILE] = None
    name: Annotated[
        str | None, Option("Name of the new machine. Default: the output file's.", OUTPUT, metavar="NAME")
    ] = None
    figure: Annotated[Path | None, FIGURE] = None
    force: Annotated[bool, FORCE] = False

    def check(self) -> None:
        """Raise RequestError rather than overwrite a file."""
        for path in (self.output, self.figure):
            if path is not None and path.exists() and not self.force:
                raise RequestError(f"{path} exists already; give another, or --force.")


def _check_axis(text: str) -> None:
    from ffcomp.identification.resonance_tests import direction_of

    try:
        direction_of(text)
    except ValueError:
        rule = "it is x, y, z, or a direction of x and y such as 1,-1 or 0.866,-0.5"
        raise RequestError(f"--axis {text!r}: {rule}.") from None
