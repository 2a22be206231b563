"""Options that several verbs share: one name, one meaning, one sentence."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from ffcomp.errors import RequestError
from ffcomp.request import ADVANCED, FASTER, MACHINE, OUTPUT, SPEED, Argument, Option
from gcode.dialect import DIALECTS

Offset = tuple[float, float]
if TYPE_CHECKING:
    Files = Sequence[str | Path] | str | Path
else:  # as the command line reads them
    Files = tuple[Path, ...]
FIGURES = ("", ".png", ".svg", ".pdf")
FLAVORS = tuple(DIALECTS)


def number_pair(option: str, text: str, more: str = "") -> tuple[float, float]:
    """Read `X,Y`."""
    try:
        x, y = (float(part) for part in text.split(","))
        if not isfinite(x + y):
            raise ValueError
    except ValueError:
        raise RequestError(f"{option} {text!r}: two numbers with a comma between them{more}.") from None
    return x, y


def parse_offset(text: str) -> Offset | None:
    """Read `X,Y` in mm; None for `auto`."""
    return None if text == "auto" else number_pair("--offset-mm", text, ", in mm")


def parse_figure(text: str) -> Path:
    """Read the name of a figure; without a suffix it is a .png."""
    path = Path(text)
    if path.suffix.lower() not in FIGURES:
        raise RequestError(f"{text}: the name of a figure ends in {', '.join(FIGURES[1:])}.")
    return path if path.suffix else path.with_name(f"{path.name}.png")


MACHINE_NAME = Option(
    "Machine: a name (see: ffcomp machines list) or the path of its file.", MACHINE, "--machine -m", metavar="NAME"
)
STAMPED_MACHINE = Option(
    "Machine: a name or the path of its file. Compensated prints name theirs.", MACHINE, "--machine -m", metavar="NAME"
)
PLANT = Option(
    "Simulated printer, with its effects: a machine's name or file. Default: --machine, nonlinear.",
    MACHINE,
    metavar="NAME",
)
OFFSET = Option(
    "Move the print: a shift added to every position, e.g. -110,-110 for a print whose origin is a corner of the bed. "
    "auto: none if the print lies inside the print volume, else one that moves it inside.",
    MACHINE,
    "--offset-mm",
    metavar="X,Y",
    parse=parse_offset,
    unset="auto",
    label="Shift, mm",
)
FLAVOR = Option(
    "Firmware. Default: that of the machine file, else that of the print.",
    MACHINE,
    metavar="NAME",
    choices=FLAVORS,
    label="Firmware",
)
PLATE = Option(
    "Plate of a .gcode.3mf that holds several, counted from 1.", MACHINE, metavar="N", low=1, label="Comparison: plate"
)
SEGMENT_RATE = Option(
    "Highest segment rate. A lower rate compensates less.", SPEED, metavar="RATE", low=125.0, high=500.0
)
JOBS = Option("Number of processes. The output is the same.", SPEED, "--jobs -j", metavar="N", low=1)
SCHEDULER = Option(
    "Use a Dask cluster, e.g. tcp://host:8786. Its workers need ffcomp but not the files.", SPEED, metavar="ADDRESS"
)
FIGURE = Option("Draw a figure: .png, .svg or .pdf.", OUTPUT, metavar="FILE", parse=parse_figure, writes="file")
MACHINE_FILE = Option("Machine file to write.", OUTPUT, "--output -o", metavar="FILE", writes="file")
MAX_FLOW = Option(
    "Maximum volumetric flow, mm³/s. Default: the slicer's setting, or else the largest flow as sliced.",
    FASTER,
    metavar="V",
    low=0.1,
    label="Maximum volumetric flow, mm³/s",
)
MIN_LAYER_TIME = Option("Minimum layer time. Default: the slicer's setting, or else 5 s.", FASTER, metavar="S", low=0.0)
KEEP_SPEED = Option(
    "Keep the slicer's speed of one kind of line, e.g. 'External perimeter'.", FASTER, metavar="FEATURE"
)
CHANGE_SPEED = Option(
    "Change the speed of one kind of line that keeps the slicer's by default: 'Bridge infill', 'first layer'.",
    FASTER,
    metavar="FEATURE",
)
RUNS = Argument(
    "Recordings (CSV), or captures with --plan. Names that differ in -1, -2, … only are repeats.", metavar="RUNS..."
)
MOVES_PLAN = Option(
    "Plan (.json) of captures, as `record plan` wrote it; or the print (.gcode) that holds their commands.",
    MACHINE,
    "--plan",
    metavar="FILE",
)
CAPTURE_AXES = Option(
    "The printer's axes in the accelerometer's own, e.g. x,-z,y. Default: found in the captures.",
    MACHINE,
    "--axes-map",
    metavar="X,Y,Z",
)
LOWEST_FITTED = Option("Ignore frequencies below.", ADVANCED, metavar="HZ", low=0.1)
HIGHEST_FITTED = Option("Ignore frequencies above.", ADVANCED, metavar="HZ", low=1.0)
