"""The request of `compensate`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, cast

from ffcomp.errors import RequestError
from ffcomp.options import (
    CHANGE_SPEED,
    FLAVOR,
    JOBS,
    KEEP_SPEED,
    MACHINE_NAME,
    MAX_FLOW,
    MIN_LAYER_TIME,
    OFFSET,
    SCHEDULER,
    SEGMENT_RATE,
    Files,
    Offset,
)
from ffcomp.request import (
    ACCURACY,
    ADVANCED,
    FASTER,
    MACHINE,
    OUTPUT,
    SPEED,
    Argument,
    MachineLike,
    Option,
    Request,
    silent,
)

Kind = Literal["gcode", "steps", "klipper-steps", "host"]
ENDINGS: Mapping[Kind, str] = {"steps": ".npz", "klipper-steps": ".npz", "host": ".ffm"}
_QUICKER = ("max_flow_mm3_per_s", "max_speed_mm_per_s", "min_layer_time_s", "keep_speed", "change_speed", "safety")
MACHINE_TO_PRINT_ON = replace(MACHINE_NAME, env="FFCOMP_MACHINE")


def parse_errors(texts: Sequence[str]) -> float | dict[str, float]:
    """Read bounds of the contour error: a number of µm for all lines, `Feature=number` for one kind of line."""
    errors = dict[str, float]()
    for text in texts:
        feature, _, number = text.rpartition("=")
        if feature.strip() in errors:
            raise RequestError(f"--max-error-um {text}: it is given twice.")
        try:
            errors[feature.strip()] = float(number)
        except ValueError:
            raise RequestError(f"--max-error-um {text}: it is a number of µm, or Feature=number.") from None
    return errors[""] if set(errors) == {""} else errors


@dataclass(frozen=True, kw_only=True)
class CompensateOptions(Request):
    """How prints are compensated."""

    kind: Annotated[
        Kind,
        Option(
            "Kind of output: gcode; steps, the time of every step (.npz); klipper-steps, the same compressed into rows "
            "(.npz); host, the motion that the module for Klipper's and Kalico's host plays (.ffm).",
            OUTPUT,
            metavar="KIND",
        ),
    ] = "gcode"
    offset_mm: Annotated[Offset | None, OFFSET] = None
    flavor: Annotated[str, FLAVOR] = ""
    force: Annotated[
        bool,
        Option(
            "Compensate a file that is already compensated.",
            OUTPUT,
            label="Compensate again what is compensated already",
        ),
    ] = False
    embed: Annotated[
        bool,
        Option("Keep the original's moves in the file as comments, for restore, show, simulate and compare.", OUTPUT),
    ] = True
    keep_shaper: Annotated[
        bool | None,
        Option(
            "Leave the firmware's own input shaper on. Default: off during the print and on again at its end, if the "
            "machine file has it. --no-keep-shaper: off even if the machine file does not have it, and left off.",
            MACHINE,
            label="Keep the firmware's own shaper on",
        ),
    ] = None
    predict: Annotated[bool, Option("Simulate the print before and after with the design model.", SPEED)] = True
    max_segments_per_second: Annotated[float, SEGMENT_RATE] = 250.0
    robust: Annotated[
        Literal["auto", "on", "off"],
        Option(
            "Minimise the expected contour error over the machine file's uncertainties. auto: if that gains anything; "
            "if the firmware's own shaper leaves less, set that instead.",
            ACCURACY,
            metavar="WHEN",
            label="Robust to what the machine file does not know",
        ),
    ] = "auto"
    strict: Annotated[bool, Option("Stop with exit code 6 where a limit would slow the print down.", ACCURACY)] = False
    tolerance_um: Annotated[
        float,
        Option(
            "Largest path error that an active limit may cause before the print is slowed down.",
            ACCURACY,
            metavar="UM",
            low=0.1,
        ),
    ] = 25.0
    max_error_um: Annotated[
        float | Mapping[str, float] | None,
        Option(
            "Print as quickly as a contour error below this allows. 'Feature=UM': another bound for one kind of line, "
            "named as in the file.",
            FASTER,
            metavar="UM",
            parse=parse_errors,
            repeated=True,
            label="Quicker, with an error of at most (µm)",
        ),
    ] = None
    max_flow_mm3_per_s: Annotated[float | None, MAX_FLOW] = None
    max_speed_mm_per_s: Annotated[
        float | None, Option("Highest speed of the nozzle, mm/s.", FASTER, metavar="V", low=1.0)
    ] = None
    min_layer_time_s: Annotated[float | None, MIN_LAYER_TIME] = None
    keep_speed: Annotated[tuple[str, ...], KEEP_SPEED] = ()
    change_speed: Annotated[tuple[str, ...], CHANGE_SPEED] = ()
    safety: Annotated[
        float,
        Option(
            "Share of printers within the machine file's uncertainty that may exceed the bound.",
            FASTER,
            metavar="SHARE",
            low=0.001,
            high=0.5,
        ),
    ] = 0.05
    extruder_steps_per_mm: Annotated[
        float | None,
        Option(
            "Extruder microsteps per mm of filament, for step timings, if the machine file does not state them.",
            ADVANCED,
            metavar="N",
            low=1.0,
        ),
    ] = None
    jobs: Annotated[int, JOBS] = 1
    scheduler: Annotated[str, SCHEDULER] = ""

    @property
    def errors_um(self) -> dict[str, float]:
        """The bounds by kind of line; that of all others has no name. Empty: none."""
        bound = self.max_error_um
        return {} if bound is None else {"": float(bound)} if isinstance(bound, int | float) else dict(bound)

    def check(self) -> None:
        """Check options that depend on each other."""
        if not self.errors_um:
            self.unused("needs the error that a quicker print may have: --max-error-um UM", *_QUICKER)
            return
        if both := {each.lower() for each in self.keep_speed} & {each.lower() for each in self.change_speed}:
            raise RequestError(f"--keep-speed and --change-speed both name {min(both)!r}.")
        for um in self.errors_um.values():
            if not 0.1 <= um <= 10_000.0:
                raise RequestError(f"--max-error-um {um:g}: it is a number of µm from 0.1 to 10000.")
        if "" not in self.errors_um:
            raise RequestError("One --max-error-um without a feature says what holds for all others.")


@dataclass(frozen=True)
class CompensateRequest(CompensateOptions):
    """Prints to be compensated. Without an output the command line changes them in place, and Python writes nothing."""

    files: Annotated[
        Files,
        Argument(
            "Sliced prints: G-code, also in .gz, .gcode.3mf or .bgcode. Changed in place without -o or --output-dir.",
            metavar="FILE...",
        ),
        "Sliced print: G-code, also in .gz, .gcode.3mf or .bgcode. A single one; call it for each of several.",
    ]
    machine: Annotated[MachineLike, MACHINE_TO_PRINT_ON]
    output: Annotated[
        Path | str | None,
        Option("Write here and leave the input unchanged.", OUTPUT, "--output -o", metavar="FILE"),
        "File to write, which may be the print itself. Nothing is written without it and output_dir.",
    ] = None
    output_dir: Annotated[
        Path | str | None,
        Option("Write files of the same names here and leave the inputs unchanged.", OUTPUT, metavar="DIR"),
    ] = None
    dry_run: Annotated[bool, Option("Do everything, write nothing.", OUTPUT)] = False
    progress: Annotated[Callable[[float], None], "Called with the share of the file that is done."] = silent

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files, as `Request` keeps them."""
        return cast("tuple[Path, ...]", self.files)

    def check(self) -> None:
        """Check options that depend on each other."""
        super().check()
        if self.output is None:
            return
        if self.output_dir is not None:
            raise RequestError("-o names a file and --output-dir a folder: give one of them.")
        if len(self.paths) > 1:
            raise RequestError("-o is for one file: give --output-dir DIR, or in Python call compensate() for each.")
        ending = ENDINGS.get(self.kind, ".gcode")
        if Path(self.output).suffix in {".gcode", *ENDINGS.values()} - {ending}:
            raise RequestError(f"-o {self.output}: --kind {self.kind} writes a file that ends in {ending}.")
