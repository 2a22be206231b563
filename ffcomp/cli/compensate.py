"""`ffcomp compensate`: the main job, by hand or as a slicer's post-processing script."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.cli.faster_options import (
    ChangeSpeed,
    IfKnown,
    KeepSpeed,
    MaxError,
    MaxFlow,
    MaxSpeed,
    MinLayerTime,
    Safety,
    bound_of,
    shares_known,
)
from ffcomp.cli.options import AsJson, Flavor, Jobs, Quiet, Scheduler, SegmentRate, check_choice, parsed_offset
from ffcomp.request import ACCURACY, ADVANCED, MACHINE, OUTPUT, SPEED

if TYPE_CHECKING:
    from ffcomp.compensate.job import Options, StepOutput
    from ffcomp.compensate.result import FileResult
    from ffcomp.integrations.slicer import Call
    from ffcomp.inverse.robust import RobustChoice
    from ffcomp.inverse.settings import Settings
    from models.machine import Machine

Printed = Annotated[
    list[Path],
    typer.Argument(
        help="Sliced prints: G-code, also in .gz, .gcode.3mf or .bgcode. Changed in place without -o or --output-dir.",
        metavar="FILE...",
    ),
]
RequiredMachine = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        metavar="NAME",
        envvar="FFCOMP_MACHINE",
        rich_help_panel=MACHINE,
        help="Machine: a name (see: ffcomp machines list) or the path of its file.",
    ),
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output-file", "-o", metavar="FILE", rich_help_panel=OUTPUT, help="Write here and leave the input unchanged."
    ),
]
OutputDir = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", rich_help_panel=OUTPUT, help="Write files of the same names here and leave the inputs unchanged."
    ),
]
Kind = Annotated[
    str,
    typer.Option(
        "--output",
        metavar="KIND",
        rich_help_panel=OUTPUT,
        help="Kind of output: gcode; steps, the time of every step (.npz); klipper-steps, the same compressed into "
        "rows (.npz); host, the motion that the module for Klipper's and Kalico's host plays (.ffm).",
    ),
]
ExtruderSteps = Annotated[
    float | None,
    typer.Option(
        metavar="N",
        rich_help_panel=ADVANCED,
        min=1.0,
        help="Extruder microsteps per mm of filament, for step timings, if the machine file does not state them.",
    ),
]
AutoOffset = Annotated[
    str,
    typer.Option(
        "--offset-mm",
        metavar="X,Y",
        rich_help_panel=MACHINE,
        help="Move the print: a shift added to every position, e.g. -110,-110 for a print whose origin is a corner of "
        "the bed. auto: none where the print lies inside as it is, else one that brings it inside.",
    ),
]
DryRun = Annotated[bool, typer.Option("--dry-run", rich_help_panel=OUTPUT, help="Do everything, write nothing.")]
Recompensate = Annotated[
    bool, typer.Option("--force", rich_help_panel=OUTPUT, help="Compensate a file that is already compensated.")
]
Embed = Annotated[
    bool,
    typer.Option(
        "--embed/--no-embed",
        rich_help_panel=OUTPUT,
        help="Keep the original's moves in the file as comments, for restore, show, simulate and compare.",
    ),
]
ShaperOff = Annotated[
    bool,
    typer.Option(
        "--shaper-off",
        rich_help_panel=MACHINE,
        help="Switch the firmware's input shaper off in the file.",
    ),
]
Predict = Annotated[
    bool, typer.Option(rich_help_panel=SPEED, help="Simulate the print before and after with the design model.")
]
Inverse = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        rich_help_panel=ADVANCED,
        help="Inverse: fast; exact, the reference, far slower; none, for step timings only.",
    ),
]
Robust = Annotated[
    bool | None,
    typer.Option(
        "--robust/--no-robust",
        rich_help_panel=ACCURACY,
        help="Minimise the expected contour error over the machine file's uncertainties. Without either, or with "
        "--robust auto: where its [uncertainty] makes it pay.",
    ),
]
Strict = Annotated[
    bool,
    typer.Option(
        "--strict", rich_help_panel=ACCURACY, help="Stop with exit code 6 where a limit would slow the print down."
    ),
]
Tolerance = Annotated[
    float,
    typer.Option(
        "--tolerance-um",
        metavar="UM",
        rich_help_panel=ACCURACY,
        min=0.1,
        help="Largest path error that an active limit may cause before the print is slowed down.",
    ),
]
SCurve = Annotated[
    bool,
    typer.Option(
        "--s-curve",
        rich_help_panel=ACCURACY,
        help="Limit the jerk of the ramps: lower peaks for at most one percent more time.",
    ),
]


OUTPUTS = ("gcode", "steps", "klipper-steps", "host")
SUFFIXES = {"gcode": "", "host": ".ffm"}
INVERSES = ("fast", "exact", "none")
ROW_ERROR_S = 12.5e-6  # of a step of compressed rows, early or late: half of what Klipper allows itself


def compensate(
    files: Printed,
    machine: RequiredMachine,
    output_file: Output = None,
    output_dir: OutputDir = None,
    output: Kind = "gcode",
    offset_mm: AutoOffset = "auto",
    flavor: Flavor = "",
    dry_run: DryRun = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    force: Recompensate = False,
    max_segments_per_second: SegmentRate = 250.0,
    embed: Embed = True,
    shaper_off: ShaperOff = False,
    predict: Predict = True,
    inverse: Inverse = "fast",
    s_curve: SCurve = False,
    robust: Robust = None,
    strict: Strict = False,
    tolerance_um: Tolerance = 25.0,
    max_error_um: MaxError = None,
    max_flow_mm3_per_s: MaxFlow = None,
    max_speed_mm_per_s: MaxSpeed = None,
    min_layer_time_s: MinLayerTime = None,
    keep_speed: KeepSpeed = None,
    change_speed: ChangeSpeed = None,
    safety: Safety = 0.05,
    if_known: IfKnown = "",
    extruder_steps_per_mm: ExtruderSteps = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = "",
) -> None:
    """Compensate a print for your printer's vibration.

    ffcomp plans the print as the firmware does, computes the carriage paths and inverts the machine's vibration model
    along them. Lines that are not moves pass through byte for byte.

    As a slicer's post-processing script, use the full path of ffcomp followed by: compensate --machine NAME. The
    slicer adds the file. See: ffcomp integrations. Every run is logged: ffcomp --log-path.

    Example: ffcomp compensate sample_prints/ringing_tower.gcode --machine mp-delta-pro -o out.gcode
    """
    from ffcomp.cli.common import exit_codes, print_json, say, say_assumed

    with exit_codes():
        check_choice("--output", output, OUTPUTS)
        check_choice("--inverse", inverse, INVERSES)
        if inverse == "none" and output == "gcode":
            raise typer.BadParameter("--inverse none leaves the G-code as it is; it is for --output steps and host.")
        offset = None if offset_mm == "auto" else parsed_offset(offset_mm)
        bound = bound_of(
            max_error_um,
            max_flow_mm3_per_s,
            max_speed_mm_per_s,
            min_layer_time_s,
            keep_speed,
            change_speed,
            safety,
            s_curve,
        )
        known_to = shares_known(if_known, bound)
        if known_to and len(files) > 1:
            raise typer.BadParameter("--if-known is for one file.")
        targets = _targets(files, output_file, output_dir, dry_run, SUFFIXES.get(output, ".npz"))

        from ffcomp.cli.machine_files import remember
        from ffcomp.compensate.job import Options
        from ffcomp.integrations.slicer import read_call
        from models.file import load_machine

        known, call = load_machine(machine), read_call(os.environ)
        remember(known)
        say_assumed([known], quiet)
        advice = _advised(known, files, offset, call)
        for sentence in advice if len(files) > 1 else ():
            say(f"ffcomp: {sentence}", quiet)
        settings = _settings(
            known,
            max_segments_per_second,
            inverse="fast" if inverse == "none" else inverse,
            s_curve=s_curve and inverse != "none",
            strict=strict,
            tolerance_um=tolerance_um,
            embed=embed,
        )
        settings, chosen = _robustly(known, settings, robust, inverse == "none" or bound is not None)
        options = Options(
            offset=offset,
            flavor=flavor,
            settings=settings,
            predict=predict,
            shaper_off=shaper_off,
            force=force,
            steps=_steps(known, output, inverse == "none", extruder_steps_per_mm),
            bed=call.bed,
            bound=bound,
            robust=chosen,
        )
        request = _Request(files, targets, known, options, jobs, scheduler, quiet, advice, known_to)
        file_results = [] if len(files) == 1 else _compensate_all(request)
        result = _batch_json(file_results) if file_results else _compensate_one(request)
        if as_json:
            print_json(result)
    for file_result in file_results:
        if file_result.failure is not None:
            raise typer.Exit(file_result.failure.exit_code)


@dataclass(frozen=True, slots=True)
class _Request:
    """Everything that was asked for."""

    files: list[Path]
    targets: Sequence[Path | None]
    machine: Machine
    options: Options
    jobs: int
    scheduler: str
    quiet: bool
    advice: list[str]  # said before the work begins
    known: list[float]  # uncertainties at which the quicker print's time is measured too


def _advised(machine: Machine, files: list[Path], offset: tuple[float, float] | None, call: Call) -> list[str]:
    """Collect warnings about the slicer's settings, and about an offset that does not suit its bed."""
    from ffcomp.integrations.slicer import bed_of, bed_warning, call_warnings

    warnings = call_warnings(call)
    bed = call.bed or (bed_of(files[0]) if len(files) == 1 else None)  # several may be for several beds
    return warnings if bed is None or offset is None else warnings + bed_warning(bed, machine, offset)


def _steps(machine: Machine, output: str, plain: bool, per_mm: float | None) -> StepOutput | None:
    """Describe the step timings that are asked for; None for G-code."""
    if output == "gcode":
        return None
    from ffcomp.compensate.job import StepOutput
    from ffcomp.steps.sink import Board

    if output == "host":  # whose own settings make the steps
        return StepOutput(Board(1.0), None, plain, motion=True)
    per_mm = per_mm or machine.steps.extruder_steps_per_mm
    if per_mm is None:
        raise typer.BadParameter(
            f"--output {output} needs the extruder's microsteps per mm of filament: --extruder-steps-per-mm N, or "
            "extruder_steps_per_mm in [steps] of the machine file."
        )
    return StepOutput(Board(per_mm), ROW_ERROR_S if output == "klipper-steps" else None, plain)


def _targets(
    files: list[Path], output_file: Path | None, output_dir: Path | None, dry_run: bool, suffix: str
) -> list[Path] | list[None]:
    """Choose the target of each file. With a suffix the output is no G-code and never replaces any."""
    from ffcomp.compensate.batch import check_targets, targets_in

    if output_file is not None and (len(files) > 1 or output_dir is not None):
        raise typer.BadParameter("-o is for one file; several go into a folder with --output-dir DIR.")
    try:
        targets = targets_in(output_dir, files) if output_dir is not None else files
        if suffix:
            targets = [target.with_suffix(suffix) for target in targets]
        check_targets(files, targets)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    if dry_run:
        return [None] * len(files)
    if output_dir is not None:
        output_dir.mkdir(parents=True, exist_ok=True)
    return [output_file] if output_file is not None else targets


def _settings(machine: Machine, rate: float, **changes: Any) -> Settings:
    from ffcomp.inverse.settings import settings_for

    return replace(settings_for(machine, rate), **changes)


def _robustly(machine: Machine, settings: Settings, asked: bool | None, decided: bool) -> tuple[Settings, RobustChoice]:
    """Return the settings with the choice of the reference, and the choice.

    decided : by another option, unless it is asked for
    """
    from ffcomp.inverse.robust import PLAIN, choose_robust

    choice = PLAIN if decided and asked is None else choose_robust(machine, settings, asked)
    return replace(settings, robust=choice.robust), choice


def _compensate_one(request: _Request) -> dict[str, Any]:
    """Compensate a single file, its chunks on several processes, and return its JSON object.

    The user never sees the name of a slicer's temporary file, so messages name the output instead.
    """
    from ffcomp.cli.common import Progress, say, tell
    from ffcomp.cli.compensate_report import report
    from ffcomp.cli.log import note
    from ffcomp.compensate.batch import size_of, workers
    from ffcomp.compensate.file import compensate_file
    from ffcomp.compensate.statistics import MOST_LINES, shortened
    from gcode.text import PART_BYTES
    from models.machine import assumed_modes

    (file,), (target,), quiet = request.files, request.targets, request.quiet
    name = os.environ.get("SLIC3R_PP_OUTPUT_NAME") or str(file)
    chunks = max(size_of(file) // PART_BYTES, 1)
    before = _original(file) if request.known else b""  # the file may be replaced
    with workers(min(request.jobs, chunks), request.scheduler) as at_once, Progress(1.0, quiet) as progress:
        result = compensate_file(file, name, request.machine, request.options, target, jobs=at_once, progress=progress)
    result["input"] = str(file)
    if "already" in result:
        say(result["already"], quiet)
        return {**result, "output": str(file)}
    if request.known:
        result["faster"]["if_known"] = _worth_knowing(request, before, name, result)
    result["warnings"] = [*request.advice, *result["warnings"]]
    result["warning_lines"] = shortened([*request.advice, *result["warning_lines"]])
    for warning in result["warnings"]:
        note(f"ffcomp: {warning}")
    said = assumed_modes(request.machine) is not None  # before the work began: five lines altogether
    for line in shortened(result["warning_lines"], MOST_LINES - said):
        tell(f"ffcomp: {line}", quiet)
    report(result, request.machine.path, quiet)
    return result


def _original(file: Path) -> bytes:
    from gcode.container import read_bytes
    from gcode.embedded import already_processed, original

    data = read_bytes(file, None)
    return data if already_processed(data) is None else original(data)


def _worth_knowing(request: _Request, data: bytes, name: str, result: dict[str, Any]) -> Any:
    """Measure what the quicker print would take with a better known machine."""
    from ffcomp.compare.quickest_plans import worth_knowing
    from ffcomp.numerics.serialise import to_json

    options = request.options
    assert options.bound is not None and options.settings is not None
    found = worth_knowing(
        data,
        name,
        request.machine,
        options.settings,
        options.bound,
        request.known,
        result["faster"]["print_time_s"],
        offset=tuple(result["offset_mm"]),
        flavor=result["flavor"],
    )
    return to_json(found)


def _compensate_all(request: _Request) -> list[FileResult]:
    """Compensate several files; return their results in the order given."""
    from ffcomp.cli.common import Progress, fail
    from ffcomp.cli.compensate_report import report_all
    from ffcomp.compensate.batch import compensate_files, size_of
    from ffcomp.errors import interrupts_restored
    from gcode.atomic_write import drafts_noted, replaced_since

    files, noted = request.files, drafts_noted()
    file_results: list[FileResult] = []
    with Progress(sum(map(size_of, files)), request.quiet) as progress:
        work = compensate_files(
            files,
            request.machine,
            request.options,
            targets=request.targets,
            jobs=request.jobs,
            scheduler=request.scheduler,
            progress=progress,
        )
        try:
            with interrupts_restored(), closing(work):
                file_results.extend(work)
        except KeyboardInterrupt:
            done = len(replaced_since(noted))
            fail(f"Interrupted; {done} of {len(files)} files are done, the others as they were.", 130)
    file_results.sort(key=lambda file_result: file_result.number)
    report_all(file_results, request.quiet)
    return file_results


def _batch_json(file_results: list[FileResult]) -> dict[str, Any]:
    """Return the JSON object of several files."""
    results = [_result(file_result) for file_result in file_results]
    failed = sum(file_result.failure is not None for file_result in file_results)
    return {"schema": "ffcomp-compensate-batch/1", "results": results, "failed": failed}


def _result(file_result: FileResult) -> dict[str, Any]:
    failure = file_result.failure
    if failure is None:
        return file_result.result
    return {"input": str(file_result.file), "error": failure.sentence, "exit_code": failure.exit_code}
