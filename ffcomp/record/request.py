"""The requests of `ffcomp record plan`, `record join` and `record check`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from ffcomp.errors import RequestError
from ffcomp.options import CAPTURE_AXES, FIGURE, FLAVORS, MACHINE_NAME, MOVES_PLAN, number_pair
from ffcomp.request import ACCURACY, ADVANCED, FORCE, MACHINE, OUTPUT, Argument, Option, Request

Purpose = Literal["identify", "diagnose", "check", "scan"]
CENTRE, LINE_OF_ACTION = "centre", "line-of-action"
MOVES = ("zigzag", "reversals", "loop", "multisine")

GCODE = Option(
    "G-code to write. The plan is written next to it (.json).", OUTPUT, "--output -o", metavar="FILE", writes="file"
)
FLAVOR = Option(
    "Firmware. Default: the machine file's, or klipper.", MACHINE, metavar="NAME", choices=FLAVORS, label="Firmware"
)
CHIP = Option(
    "Accelerometer: Klipper's name of it (default adxl345), or RepRapFirmware's address (default 0). May be repeated.",
    MACHINE,
    metavar="NAME",
)
RUNS_FOLDER = Option("Folder for the measured runs.", OUTPUT, metavar="DIR", writes="folder")


_PLACED = {"at", "repeats", "amplitude_mm_per_s2", "height_mm", "seed"}
_OPTIONS_OF: dict[Purpose, set[str]] = {
    "identify": _PLACED | {"axes", "lowest_hz", "highest_hz", "period_s", "periods"},
    "diagnose": _PLACED | {"kind", "seconds", "print_file"},
    "check": set(),
    "scan": {"amplitude_mm_per_s2", "height_mm", "seed", "pen", "line_width_mm", "nozzle_c", "bed_c"},
}  # those that some purposes have and others have not; the others have fixed values


@dataclass(frozen=True, kw_only=True)
class PlanRequest(Request):
    """Purpose of the recording, and the output file. None: the purpose's default."""

    machine: Annotated[str, MACHINE_NAME]
    output: Annotated[Path, GCODE]
    purpose: Annotated[
        Purpose,
        Option(
            "What the file is for: identify (the numbers of a machine file), diagnose (what it lacks), check (whether "
            "the printer has changed), each from captures of an accelerometer; or scan (the numbers of a machine file, "
            "without a sensor: a page to print, for ffcomp identify scan).",
            MACHINE,
            "--for",
            metavar="VERB",
        ),
    ] = "diagnose"
    at: Annotated[
        tuple[str, ...],
        Option(
            "Place of experiments, mm. May be repeated; for diagnose, places are 40 mm apart or more. centre: the "
            "middle of the bed (default of identify). line-of-action: for identify, three places away from each tower "
            "of a delta, where the dynamics differ most. Default of diagnose: the centre, and three places around it.",
            MACHINE,
            metavar="X,Y",
            label="At X,Y, mm",
        ),
    ] = ()
    kind: Annotated[
        tuple[str, ...],
        Option(
            "For diagnose, only such moves: zigzag, reversals, loop or multisine; may be repeated.",
            ADVANCED,
            metavar="NAME",
        ),
    ] = ()
    axes: Annotated[
        str | None,
        Option(
            "For identify. towers: each carriage alone (default of a delta); all: towers and xyz; or the nozzle along "
            "x, y, z, xy (default of cartesian and CoreXY) or xyz.",
            MACHINE,
            metavar="AXES",
        ),
    ] = None
    seconds: Annotated[
        float | None,
        Option(
            "Duration of an experiment for diagnose, about. Default: 4.",
            ACCURACY,
            metavar="S",
            low=2.0,
            high=20.0,
            label="Diagnosis: each experiment, s",
        ),
    ] = None
    repeats: Annotated[
        int | None,
        Option(
            "Repeats of each experiment; they reveal the noise. Default: 2; 1 for identify, which repeats periods.",
            ACCURACY,
            metavar="N",
            low=1,
            high=9,
            label="How often each",
        ),
    ] = None
    lowest_hz: Annotated[
        float | None, Option("Lowest frequency for identify. Default: 5.", ACCURACY, metavar="HZ", low=0.5)
    ] = None
    highest_hz: Annotated[
        float | None, Option("Highest frequency for identify. Default: 150.", ACCURACY, metavar="HZ", low=1.0)
    ] = None
    amplitude_mm_per_s2: Annotated[
        float | None,
        Option(
            "Acceleration of the nozzle for diagnose (default: the machine file's limit), peak of the excitation for "
            "identify (default: a safe share of the machine's limits), of the strokes for scan (default: 8000, or what "
            "the carriages allow).",
            ACCURACY,
            metavar="A",
            low=1.0,
        ),
    ] = None
    period_s: Annotated[
        float | None,
        Option(
            "Period for identify. Its inverse is the frequency step. Default: 4.",
            ADVANCED,
            metavar="S",
            low=2.0,
            high=60.0,
        ),
    ] = None
    periods: Annotated[
        int | None,
        Option(
            "Periods to average for identify, after a first one that settles. Default: 6.", ADVANCED, metavar="N", low=1
        ),
    ] = None
    height_mm: Annotated[
        float | None,
        Option(
            "Nozzle height above the bed. Default: 30; 50 for identify; for scan the layer's, 0.2.",
            MACHINE,
            metavar="MM",
            label="Nozzle height, mm",
        ),
    ] = None
    flavor: Annotated[str, FLAVOR] = ""
    chip: Annotated[tuple[str, ...], CHIP] = ()
    print_file: Annotated[
        Path | None,
        Option(
            "For diagnose: record this print instead of ffcomp's own moves, up to 12 stretches of its first layers. "
            "Print the file that -o names.",
            OUTPUT,
            "--print",
            metavar="FILE",
        ),
    ] = None
    pen: Annotated[
        bool | None,
        Option(
            "For scan: a pen in the nozzle's place draws on paper; --height-mm is where it touches. Default: no.",
            MACHINE,
        ),
    ] = None
    line_width_mm: Annotated[
        float | None, Option("For scan: width of the lines. Default: 0.45.", MACHINE, metavar="MM", low=0.1, high=1.2)
    ] = None
    nozzle_c: Annotated[
        float | None,
        Option("For scan: temperature of the nozzle. Default: 210.", MACHINE, metavar="C", low=0.0, high=350.0),
    ] = None
    bed_c: Annotated[
        float | None,
        Option("For scan: temperature of the bed. Default: 60.", MACHINE, metavar="C", low=0.0, high=150.0),
    ] = None
    seed: Annotated[
        int | None, Option("Seed of the moves or the phases. Default: 1.", ADVANCED, metavar="N", low=0)
    ] = None
    force: Annotated[bool, FORCE] = False

    @property
    def plan_file(self) -> Path:
        """The plan's path, next to the G-code."""
        return self.output.with_suffix(".json")

    def check(self) -> None:
        """Raise RequestError where options do not go together."""
        for name in sorted(set().union(*_OPTIONS_OF.values()) - _OPTIONS_OF[self.purpose]):
            purposes = " and ".join(purpose for purpose, names in _OPTIONS_OF.items() if name in names)
            self.unused(f"is for --for {purposes}, not for --for {self.purpose}", name)
        if self.plan_file == self.output:
            raise RequestError(f"-o {self.output}: the G-code needs another ending, for .json is that of its plan.")
        words = (CENTRE, LINE_OF_ACTION) if self.purpose == "identify" else ()
        for place in self.at:
            if place not in words:
                number_pair("--at", place, f", in mm{f', {CENTRE} or {LINE_OF_ACTION}' if words else ''}")
        one_of("--kind", self.kind, MOVES)


def one_of(option: str, values: Iterable[str], choices: Iterable[str]) -> None:
    """Raise RequestError unless all values are among the choices."""
    for value in values:
        if value not in choices:
            *most, last = choices
            raise RequestError(f"{option}: there is no {value!r}; choose {', '.join(most)} or {last}.")


@dataclass(frozen=True, kw_only=True)
class JoinRequest(Request):
    """Captures to be joined with their commands."""

    captures: Annotated[
        tuple[Path, ...],
        Argument(
            "Captures of the plan: files of Klipper, Kalico, RepRapFirmware or Shake&Tune, or tables with a time and "
            "three accelerations.",
            metavar="CAPTURES...",
        ),
    ]
    plan: Annotated[Path, MOVES_PLAN]
    machine: Annotated[str, MACHINE_NAME]
    output_dir: Annotated[Path, RUNS_FOLDER]
    axes_map: Annotated[str | None, CAPTURE_AXES] = None
    force: Annotated[bool, FORCE] = False


@dataclass(frozen=True, kw_only=True)
class CheckRequest(Request):
    """A check of a printer by its captures."""

    captures: Annotated[tuple[Path, ...], Argument("Captures of the check's G-code.", metavar="CAPTURES...")]
    plan: Annotated[Path, MOVES_PLAN]
    machine: Annotated[str, MACHINE_NAME]
    history: Annotated[
        Path | None,
        Option(
            "Earlier checks; this one is added. Default: next to the machine file, .checks.jsonl.",
            OUTPUT,
            metavar="FILE",
        ),
    ] = None
    axes_map: Annotated[str | None, CAPTURE_AXES] = None
    figure: Annotated[Path | None, FIGURE] = None

    @property
    def history_file(self) -> Path:
        """The history: by default next to the machine file, or here for a library machine."""
        machine = Path(self.machine)
        beside = machine.with_suffix(".checks.jsonl") if machine.is_file() else Path(f"{machine.name}.checks.jsonl")
        return self.history or beside
