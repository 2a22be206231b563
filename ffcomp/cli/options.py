"""Options that several verbs share: one name, one meaning, one help text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from ffcomp.request import ADVANCED, MACHINE, OUTPUT, SPEED

MachineName = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        metavar="NAME",
        rich_help_panel=MACHINE,
        help="Machine: a name (see: ffcomp machines list) or the path of its file.",
    ),
]
StampedMachine = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        metavar="NAME",
        rich_help_panel=MACHINE,
        help="Machine: a name or the path of its file. Compensated prints name theirs.",
    ),
]
Plant = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        rich_help_panel=MACHINE,
        help="Simulated printer, with its effects: a machine's name or file. Default: --machine, nonlinear.",
    ),
]
Offset = Annotated[
    str,
    typer.Option(
        "--offset-mm",
        metavar="X,Y",
        rich_help_panel=MACHINE,
        help="Shift added to every position, for a print whose origin is a corner of the bed, e.g. -110,-110.",
    ),
]
Flavor = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        rich_help_panel=MACHINE,
        help="Firmware: klipper, marlin or reprapfirmware. Default: what the machine file says, or else the print.",
    ),
]
Plate = Annotated[
    int | None,
    typer.Option(
        metavar="N", rich_help_panel=MACHINE, min=1, help="Plate of a .gcode.3mf that holds several, counted from 1."
    ),
]
SegmentRate = Annotated[
    float,
    typer.Option(
        "--max-segments-per-second",
        metavar="RATE",
        rich_help_panel=SPEED,
        min=125.0,
        max=500.0,
        help="Highest segment rate. A lower rate follows less of the vibration.",
    ),
]
Jobs = Annotated[
    int,
    typer.Option(
        "--jobs", "-j", metavar="N", rich_help_panel=SPEED, min=1, help="Number of processes. The output is the same."
    ),
]
Scheduler = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS",
        rich_help_panel=SPEED,
        help="Use a Dask cluster, e.g. tcp://host:8786. Its workers need ffcomp but not the files.",
    ),
]
Report = Annotated[
    Path | None,
    typer.Option(
        "--report", "-r", metavar="FILE", rich_help_panel=OUTPUT, help="Write one HTML page that opens offline."
    ),
]
Figure = Annotated[
    Path | None,
    typer.Option("--figure", metavar="FILE", rich_help_panel=OUTPUT, help="Draw a figure: .png, .svg or .pdf."),
]
MachineFile = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", rich_help_panel=OUTPUT, help="Machine file to write."),
]
Force = Annotated[bool, typer.Option("--force", rich_help_panel=OUTPUT, help="Overwrite files that exist.")]
AsJson = Annotated[bool, typer.Option("--json", rich_help_panel=OUTPUT, help="Print one JSON object on stdout.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", rich_help_panel=OUTPUT, help="Print no progress, and no message but errors.")
]
Runs = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUNS...",
        help="Recordings (CSV), or captures with --plan. Names that differ in -1, -2, … only are repeats.",
    ),
]
MovesPlanFile = Annotated[
    Path | None,
    typer.Option(
        "--plan", metavar="FILE", rich_help_panel=MACHINE, help="Plan (.json) of captures, as `record plan` wrote it."
    ),
]
CaptureAxes = Annotated[
    str | None,
    typer.Option(
        "--axes-map",
        metavar="X,Y,Z",
        rich_help_panel=MACHINE,
        help="The printer's axes in the accelerometer's own, e.g. x,-z,y. Default: found in the captures.",
    ),
]
LowestFitted = Annotated[
    float, typer.Option(rich_help_panel=ADVANCED, metavar="HZ", min=0.1, help="Ignore frequencies below.")
]
HighestFitted = Annotated[
    float, typer.Option(rich_help_panel=ADVANCED, metavar="HZ", min=1.0, help="Ignore frequencies above.")
]


def parsed_offset(text: str) -> tuple[float, float]:
    """Parse `X,Y`.

    Parameters
    ----------
    text : two numbers in mm with a comma between them

    Returns
    -------
    x, y : mm

    Raises
    ------
    typer.BadParameter
        If the text has another form.
    """
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"--offset-mm {text!r}: two numbers with a comma between them, in mm.") from None
    return x, y


def check_choice(option: str, value: str, allowed: Sequence[str]) -> None:
    """Raise typer.BadParameter unless the value is one of those allowed."""
    if value not in allowed:
        raise typer.BadParameter(f"{option}: there is no {value!r}; choose {', '.join(allowed[:-1])} or {allowed[-1]}.")
