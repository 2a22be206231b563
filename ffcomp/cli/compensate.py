"""`ffcomp compensate`: the main job."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ffcomp.job import Job
    from gcode.metadata import Stamp

Printed = Annotated[Path, typer.Argument(help="The sliced print; changed in place unless -o is given.", metavar="FILE")]
MachineName = Annotated[
    str, typer.Option("--machine", "-m", help="A machine's name (see: ffcomp machines list) or the path of its file.")
]
Output = Annotated[Path | None, typer.Option("--output-file", "-o", help="Write here; the input stays as it is.")]
Kind = Annotated[str, typer.Option("--output", help="What to write: gcode.")]
Offset = Annotated[
    str,
    typer.Option(
        "--offset-mm",
        metavar="X,Y",
        help="Added to every position: for a print made for a bed with its origin in a corner, e.g. -110,-110.",
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
        help="Switch the firmware's input shaper off in the file (Klipper: only with an [input_shaper] section).",
    ),
]
Predict = Annotated[bool, typer.Option(help="Simulate before and after with the design model.")]
Inverse = Annotated[
    str, typer.Option(help="fast, or exact: the reference it is measured against, a hundred times slower.")
]
SCurve = Annotated[
    bool, typer.Option("--s-curve", help="Ramps with limited jerk: lower peaks, within a percent of the time.")
]
Jobs = Annotated[int, typer.Option("--jobs", "-j", help="Processes to work with; the result is the same.", min=1)]


def compensate(
    file: Printed,
    machine: MachineName,
    output_file: Output = None,
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
    jobs: Jobs = 1,
) -> None:
    """Write commands whose response is the path that the slicer wanted.

    The print is planned as the firmware plans it, turned into carriage paths, and inverted through the machine's
    vibration model. What is not a move passes through byte for byte.

    Example: ffcomp compensate sample_prints/ringing_tower.gcode --machine mp-delta-pro -o out.gcode
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    with exit_codes():
        if output != "gcode":
            raise typer.BadParameter(f"--output {output}: this version writes gcode.")
        if inverse not in ("fast", "exact"):
            raise typer.BadParameter(f"--inverse {inverse}: fast or exact.")
        stamp = _stamp(file)
        if stamp is not None and not force:
            already = f"{file}: already processed by ffcomp v{stamp.version} for {stamp.machine}; nothing changed."
            result = {"schema": "ffcomp-compensate/1", "input": str(file), "output": str(file), "already": already}
            say(already, quiet)
        else:
            options = {"flavor": flavor, "shaper_off": shaper_off, "predict": predict, "jobs": jobs}
            changes = {"inverse": inverse, "s_curve": s_curve}
            offset = parsed_offset(offset_mm)
            job = _job(file, machine, offset, max_segments_per_second, changes, stamp is not None, options)
            result = _write(job, None if dry_run else output_file or file, quiet)
            _report(result, quiet)
        if as_json:
            print_json(result)


def parsed_offset(text: str) -> tuple[float, float]:
    """`X,Y` in mm."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"--offset-mm {text!r}: two numbers with a comma between them, in mm.") from None
    return x, y


def _stamp(file: Path) -> Stamp | None:
    """The stamp of an earlier run, if the file has one."""
    from gcode.container import ends_of
    from gcode.metadata import find_stamp

    head, tail, _ = ends_of(file)
    return find_stamp(head, tail)


def _job(
    file: Path,
    machine_name: str,
    offset: tuple[float, float],
    rate: float,
    changes: dict[str, Any],
    restore: bool,
    options: dict[str, Any],
) -> Job:
    """`restore`: compensate the original that is still in the file, not the compensation."""
    from dataclasses import replace

    from ffcomp.job import Job, find_offset
    from ffcomp.pipeline import settings_for
    from gcode.container import ends_of
    from models.machine_file import load_machine

    machine = load_machine(machine_name)
    if restore and not any(offset):
        offset = find_offset(ends_of(file)[0])
    settings = replace(settings_for(machine, rate), **changes)
    return Job(file, str(file), machine, offset=offset, settings=settings, restore=restore, **options)


def _write(job: Job, target: Path | None, quiet: bool) -> dict[str, Any]:
    from ffcomp.cli.common import Progress, say

    with Progress(1.0, quiet) as progress:
        job.write(target, progress)
    for warning in job.summary.warnings:
        say(f"ffcomp: {warning}", quiet)
    return {**job.result(), "output": None if target is None else str(target)}


def _report(result: dict[str, Any], quiet: bool) -> None:
    """The predicted gain and the cost, on stderr."""
    if quiet:
        return
    from rich.console import Console
    from rich.table import Table

    console = Console(stderr=True)
    table = Table("", "tracking rms", "without delay", "contour rms", "contour p99", "peak command")
    for name, track in result["predicted"].items():
        table.add_row(
            name,
            f"{track['tracking_rms_um']:.1f} µm",
            f"{track['tracking_rms_no_delay_um']:.1f} µm",
            f"{track['contour_rms_um']:.2f} µm",
            f"{track['contour_p99_um']:.1f} µm",
            f"{track['peak_command_acceleration_mm_per_s2'] / 1e3:.1f} m/s²",
        )
    if result["predicted"]:
        console.print(table)
    speed = result["print_time_s"] / max(result["compute_time_s"], 1e-9)
    console.print(
        f"{result['moves']} moves, {result['print_time_s']:.1f} s of print "
        f"(was {result['original_print_time_s']:.1f} s) in {result['segments']} segments; "
        f"{result['compute_time_s']:.1f} s, {speed:.0f} times faster than printing.",
        highlight=False,
    )
    if result["output"] is not None:
        console.print(f"Look at it: ffcomp show {result['output']}", highlight=False)
