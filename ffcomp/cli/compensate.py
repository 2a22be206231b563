"""`ffcomp compensate`: the main job, by hand or as a slicer's post-processing script."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ffcomp.compensate.file import Options, Outcome, StepOutput
    from ffcomp.inverse.settings import Settings
    from models.machine import Machine

Printed = Annotated[
    list[Path],
    typer.Argument(
        help="Sliced prints: G-code, also in .gz, .gcode.3mf or .bgcode; changed in place without -o or --output-dir.",
        metavar="FILE…",
    ),
]
MachineName = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        envvar="FFCOMP_MACHINE",
        help="A machine's name (see: ffcomp machines list) or the path of its file.",
    ),
]
Output = Annotated[Path | None, typer.Option("--output-file", "-o", help="Write here; the input stays as it is.")]
OutputDir = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Write files of the same names here; the inputs stay as they are.")
]
Kind = Annotated[
    str,
    typer.Option(
        "--output",
        help="What to write: gcode; steps, every step's time (.npz); klipper-steps, compressed into rows (.npz).",
    ),
]
ExtruderSteps = Annotated[
    float | None,
    typer.Option(min=1.0, help="For step timings: microsteps per mm of filament, if the machine file says none."),
]
Offset = Annotated[
    str,
    typer.Option(
        "--offset-mm",
        metavar="X,Y",
        help="Added to every position: for a print made for a bed with its origin in a corner, e.g. -110,-110; auto: "
        "middle of the slicer's bed to middle of the machine's, where they differ by more than a quarter.",
    ),
]
Flavor = Annotated[str, typer.Option(help="klipper, marlin or reprapfirmware; by default the file says it.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Do everything, write nothing.")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no messages but errors.")]
Force = Annotated[bool, typer.Option("--force", help="Compensate a file that is already stamped.")]
Rate = Annotated[
    float,
    typer.Option(
        "--max-segments-per-second",
        min=125.0,
        max=500.0,
        help="How dense the segments may get where the nozzle changes its motion; fewer follow less of the vibration.",
    ),
]
ShaperOff = Annotated[
    bool,
    typer.Option(
        "--shaper-off",
        help="Switch the firmware's input shaper off in the file (Klipper: only with an input_shaper section).",
    ),
]
Predict = Annotated[bool, typer.Option(help="Simulate before and after with the design model.")]
Inverse = Annotated[
    str,
    typer.Option(help="fast; exact: the reference it is measured against, far slower; none, for step timings alone."),
]
Robust = Annotated[
    bool,
    typer.Option(
        "--robust",
        help="Want what comes out nearest to the path on average over the machine file's uncertainties: a little worse "
        "if the file is right, far better where it is not; takes some forty times as long to work out.",
    ),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Where limits would slow the print down, stop instead (exit 6) and say where.")
]
Tolerance = Annotated[
    float,
    typer.Option(
        "--tolerance-um", min=0.1, help="How far a held limit may take the nozzle off its path before it slows down."
    ),
]
Solver = Annotated[str, typer.Option(help="Where limits bind: osqp, piqp or clarabel.")]
SCurve = Annotated[
    bool, typer.Option("--s-curve", help="Ramps with limited jerk: lower peaks, within a percent of the time.")
]
Jobs = Annotated[
    int,
    typer.Option(
        "--jobs", "-j", help="Processes to work with, on several files or on one; the result is the same.", min=1
    ),
]
Scheduler = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS",
        help="Work on a Dask cluster, e.g. tcp://host:8786, instead; its workers need ffcomp, but not the files.",
    ),
]


OUTPUTS = ("gcode", "steps", "klipper-steps")
INVERSES = ("fast", "exact", "none")
SOLVERS = ("osqp", "piqp", "clarabel")
ROW_ERROR_S = 12.5e-6  # of a step of compressed rows, early or late: half of what Klipper allows itself


def compensate(
    files: Printed,
    machine: MachineName,
    output_file: Output = None,
    output_dir: OutputDir = None,
    output: Kind = "gcode",
    offset_mm: Offset = "0,0",
    flavor: Flavor = "",
    dry_run: DryRun = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    force: Force = False,
    max_segments_per_second: Rate = 250.0,
    shaper_off: ShaperOff = False,
    predict: Predict = True,
    inverse: Inverse = "fast",
    s_curve: SCurve = False,
    robust: Robust = False,
    strict: Strict = False,
    tolerance_um: Tolerance = 25.0,
    solver: Solver = "osqp",
    extruder_steps_per_mm: ExtruderSteps = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = "",
) -> None:
    """Write commands whose response is the path that the slicer wanted.

    The print is planned as the firmware plans it, turned into carriage paths, and inverted through the machine's
    vibration model. What is not a move passes through byte for byte.

    As a slicer's post-processing script: the full path of ffcomp, then: compensate --machine NAME (the slicer adds the
    file). See: ffcomp integrations. Every run is logged: ffcomp --log-path.

    Example: ffcomp compensate sample_prints/ringing_tower.gcode --machine mp-delta-pro -o out.gcode
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    with exit_codes():
        _check_choice("--output", output, OUTPUTS)
        _check_choice("--inverse", inverse, INVERSES)
        _check_choice("--solver", solver, SOLVERS)
        if inverse == "none" and output == "gcode":
            raise typer.BadParameter("--inverse none leaves the G-code as it is; it is for --output steps.")
        offset = (0.0, 0.0) if offset_mm == "auto" else parsed_offset(offset_mm)
        targets = _targets(files, output_file, output_dir, dry_run, ".npz" if output != "gcode" else "")

        from ffcomp.compensate.file import Options
        from models.file import load_machine

        known = load_machine(machine)
        offset, advice = _advised(known, files, offset, offset_mm == "auto")
        for sentence in advice:
            say(f"ffcomp: {sentence}", quiet)
        options = Options(
            offset=offset,
            flavor=flavor,
            settings=_settings(
                known,
                max_segments_per_second,
                inverse="fast" if inverse == "none" else inverse,
                s_curve=s_curve and inverse != "none",
                robust=robust,
                strict=strict,
                tolerance_um=tolerance_um,
                solver=solver,
            ),
            predict=predict,
            shaper_off=shaper_off,
            force=force,
            steps=_steps(known, output, inverse == "none", extruder_steps_per_mm),
        )
        order = _Order(files, targets, known, options, jobs, scheduler, quiet, advice)
        outcomes = [] if len(files) == 1 else _compensate_all(order)
        result = _answer(outcomes) if outcomes else _compensate_one(order)
        if as_json:
            print_json(result)
    for outcome in outcomes:
        if outcome.failure is not None:
            raise typer.Exit(outcome.failure.exit_code)


@dataclass(frozen=True, slots=True)
class _Order:
    """Everything that was asked for."""

    files: list[Path]
    targets: Sequence[Path | None]
    machine: Machine
    options: Options
    jobs: int
    scheduler: str
    quiet: bool
    advice: list[str]  # said before the work begins


def _advised(
    machine: Machine, files: list[Path], offset: tuple[float, float], auto: bool
) -> tuple[tuple[float, float], list[str]]:
    """The offset to be used, and what the slicer's settings give reason to say."""
    from ffcomp.integrations.slicer import auto_sentence, bed_of, bed_warning, call_warnings, offset_for, read_call

    call = read_call(os.environ)
    told = call_warnings(call)
    bed = call.bed or (bed_of(files[0]) if len(files) == 1 else None)  # several may be for several beds
    if bed is None:
        if auto:
            raise typer.BadParameter("--offset-mm auto: neither the slicer nor a single file says what the bed is.")
        return offset, told
    if auto:
        return offset_for(bed, machine.kinematics.centre_mm), [*told, auto_sentence(bed, machine)]
    return offset, told + bed_warning(bed, machine, offset)


def parsed_offset(text: str) -> tuple[float, float]:
    """`X,Y` in mm."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"--offset-mm {text!r}: two numbers with a comma between them, in mm.") from None
    return x, y


def _check_choice(option: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise typer.BadParameter(f"{option} {value}: {', '.join(allowed[:-1])} or {allowed[-1]}.")


def _steps(machine: Machine, output: str, plain: bool, per_mm: float | None) -> StepOutput | None:
    """What step timings are to be like; None for G-code."""
    if output == "gcode":
        return None
    from ffcomp.compensate.file import StepOutput
    from ffcomp.steps.sink import Board

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
    """Where each file goes; with a suffix, what is written is no G-code and never replaces any."""
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


def _compensate_one(order: _Order) -> dict[str, Any]:
    """The JSON object of a single file; the processes work at its chapters.

    A slicer's file has a name that the user never sees: messages name the output instead.
    """
    from ffcomp.cli.common import Progress, say
    from ffcomp.cli.compensate_report import report
    from ffcomp.compensate.batch import size_of, workers
    from ffcomp.compensate.file import compensate_file
    from gcode.blocks import PART_BYTES

    (file,), (target,), quiet = order.files, order.targets, order.quiet
    name = os.environ.get("SLIC3R_PP_OUTPUT_NAME") or str(file)
    chapters = max(size_of(file) // PART_BYTES, 1)
    with workers(min(order.jobs, chapters), order.scheduler) as at_once, Progress(1.0, quiet) as progress:
        result = compensate_file(file, name, order.machine, order.options, target, jobs=at_once, progress=progress)
    result["input"] = str(file)
    if "already" in result:
        say(result["already"], quiet)
        return {**result, "output": str(file)}
    for warning in result["warnings"]:
        say(f"ffcomp: {warning}", quiet)
    result["warnings"] = [*order.advice, *result["warnings"]]
    report(result, order.machine.path, quiet)
    return result


def _compensate_all(order: _Order) -> list[Outcome]:
    """What became of each, in the order given."""
    from ffcomp.cli.common import Progress, fail
    from ffcomp.cli.compensate_report import report_all
    from ffcomp.compensate.batch import compensate_files, size_of

    files = order.files
    outcomes: list[Outcome] = []
    with Progress(sum(map(size_of, files)), order.quiet) as progress:
        work = compensate_files(
            files,
            order.machine,
            order.options,
            targets=order.targets,
            jobs=order.jobs,
            scheduler=order.scheduler,
            progress=progress,
        )
        try:
            with closing(work):
                outcomes.extend(work)
        except KeyboardInterrupt:
            fail(f"Interrupted; {len(outcomes)} of {len(files)} files are done, the others as they were.", 130)
    outcomes.sort(key=lambda outcome: outcome.number)
    report_all(outcomes, order.quiet)
    return outcomes


def _answer(outcomes: list[Outcome]) -> dict[str, Any]:
    """The JSON object of several files."""
    results = [_result(outcome) for outcome in outcomes]
    failed = sum(outcome.failure is not None for outcome in outcomes)
    return {"schema": "ffcomp-compensate-batch/1", "results": results, "failed": failed}


def _result(outcome: Outcome) -> dict[str, Any]:
    failure = outcome.failure
    if failure is None:
        return outcome.result
    return {"input": str(outcome.file), "error": failure.sentence, "exit_code": failure.exit_code}
