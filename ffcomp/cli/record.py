"""`ffcomp record`: moves for the printer's own sensor, and its captures joined with their command."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.cli.options import AsJson, CaptureAxes, Force, MachineName, PlanOutput, Quiet
from ffcomp.request import ACCURACY, ADVANCED, MACHINE, OUTPUT

if TYPE_CHECKING:
    from ffcomp.record.plan import Plan
    from ffcomp.record.planning import PlanResult
    from ffcomp.record.result import JoinResult

app = typer.Typer(
    no_args_is_help=True,
    help="Record the printer's vibrations with its own accelerometer.\n\n"
    "First ffcomp record plan, then run its G-code, then give the captures to ffcomp diagnose with --plan; or keep "
    "them as measured runs with ffcomp record join.",
)

For = Annotated[
    str,
    typer.Option(
        "--for",
        metavar="VERB",
        rich_help_panel=MACHINE,
        help="What the captures are for: identify (the numbers of a machine file), diagnose (what it lacks) or check "
        "(whether the printer has changed).",
    ),
]
At = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y",
        rich_help_panel=MACHINE,
        help="Place of experiments, mm. May be repeated; for diagnose, places are 40 mm apart or more. centre: the "
        "middle of the bed (default of identify). line-of-action: for identify, three places away from each tower of a "
        "delta, where the dynamics differ most. Default of diagnose: the centre, and three places around it.",
    ),
]
Kind = Annotated[
    list[str] | None,
    typer.Option(
        "--kind",
        metavar="NAME",
        rich_help_panel=ADVANCED,
        help="For diagnose, only such moves: zigzag, reversals, loop or multisine; may be repeated. For identify, the "
        "excitation: multisine (low peaks, whole periods; default), sweep or log-sweep.",
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        rich_help_panel=ACCURACY,
        min=2.0,
        max=20.0,
        help="Duration of an experiment for diagnose, about. Default: 4.",
    ),
]
Repeats = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        rich_help_panel=ACCURACY,
        min=1,
        max=9,
        help="How often each is made. Repeats show the noise. Default: 2; 1 for identify, whose periods do.",
    ),
]
Amplitude = Annotated[
    float | None,
    typer.Option(
        "--amplitude-mm-per-s2",
        metavar="A",
        rich_help_panel=ACCURACY,
        min=1.0,
        help="Acceleration of the nozzle for diagnose (default: the machine file's limit), peak of the excitation for "
        "identify (default: a safe share of the machine's limits).",
    ),
]
Height = Annotated[
    float | None,
    typer.Option(
        "--height-mm",
        metavar="MM",
        rich_help_panel=MACHINE,
        help="Nozzle height above the bed. Default: 30; 50 for identify.",
    ),
]
FirmwareName = Annotated[
    str,
    typer.Option(
        "--flavor",
        metavar="NAME",
        rich_help_panel=MACHINE,
        help="Firmware: klipper, marlin or reprapfirmware. Default: the machine file's, or klipper.",
    ),
]
Chips = Annotated[
    list[str] | None,
    typer.Option(
        "--chip",
        metavar="NAME",
        rich_help_panel=MACHINE,
        help="Accelerometer: Klipper's name of it (default adxl345), or RepRapFirmware's address (default 0). May be "
        "repeated.",
    ),
]
ShaperBack = Annotated[
    str,
    typer.Option(
        "--shaper",
        metavar="X,Y",
        rich_help_panel=MACHINE,
        help="Frequencies of the firmware's input shaper, Hz, to be switched on again at the end. RepRapFirmware knows "
        "them by itself.",
    ),
]
ShaperOff = Annotated[
    bool | None,
    typer.Option(
        "--shaper-off/--no-shaper-off",
        rich_help_panel=MACHINE,
        help="For identify: switch the firmware's input shaper off at the beginning. Default: yes.",
    ),
]
Print = Annotated[
    Path | None,
    typer.Option(
        "--print",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="For diagnose: record this print instead of ffcomp's own moves, up to 12 stretches of its first layers. "
        "Print the file that -o names.",
    ),
]
Axes = Annotated[
    str | None,
    typer.Option(
        "--axes",
        metavar="AXES",
        rich_help_panel=MACHINE,
        help="For identify. towers: each carriage alone (default of a delta); all: towers and xyz; or the nozzle along "
        "x, y, z, xy (default of cartesian and CoreXY) or xyz.",
    ),
]
Lowest = Annotated[
    float | None,
    typer.Option(metavar="HZ", rich_help_panel=ACCURACY, min=0.5, help="Lowest frequency for identify. Default: 5."),
]
Highest = Annotated[
    float | None,
    typer.Option(metavar="HZ", rich_help_panel=ACCURACY, min=1.0, help="Highest frequency for identify. Default: 150."),
]
ZAcceleration = Annotated[
    float | None,
    typer.Option(
        "--z-acceleration-mm-per-s2",
        metavar="A",
        rich_help_panel=MACHINE,
        min=1.0,
        help="For identify: the firmware's limit in Z (Klipper: max_z_accel). Default: the machine file's "
        "acceleration.",
    ),
]
Period = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        rich_help_panel=ADVANCED,
        min=2.0,
        max=60.0,
        help="Period for identify. Its inverse is the frequency step. Default: 4.",
    ),
]
Periods = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        rich_help_panel=ADVANCED,
        min=1,
        help="Periods to average for identify, after a first one that settles. Default: 6.",
    ),
]
Realisations = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        rich_help_panel=ADVANCED,
        min=1,
        help="Repetitions of the multisine with other random phases, for identify. Default: 1.",
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        "--segments-per-second",
        metavar="RATE",
        rich_help_panel=ADVANCED,
        min=125.0,
        max=500.0,
        help="Segment rate for identify. It rises if the highest frequency needs more. Default: 250.",
    ),
]
Seed = Annotated[
    int | None,
    typer.Option(metavar="N", rich_help_panel=ADVANCED, min=0, help="Seed of the moves or the phases. Default: 1."),
]
Captures = Annotated[
    list[Path],
    typer.Argument(
        metavar="CAPTURES...",
        help="Captures of the plan: files of Klipper, Kalico, RepRapFirmware or Shake&Tune, or tables with a time and "
        "three accelerations.",
    ),
]
PlanFile = Annotated[
    Path,
    typer.Option("--plan", metavar="FILE", rich_help_panel=MACHINE, help="Plan (.json) that `record plan` wrote."),
]
Folder = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="FOLDER", rich_help_panel=OUTPUT, help="Folder for the measured runs."),
]


@app.command("plan")
def plan(
    machine: MachineName,
    output_file: PlanOutput,
    purpose: For = "diagnose",
    at: At = None,
    kind: Kind = None,
    axes: Axes = None,
    seconds: Seconds = None,
    repeats: Repeats = None,
    lowest_hz: Lowest = None,
    highest_hz: Highest = None,
    amplitude_mm_per_s2: Amplitude = None,
    z_acceleration_mm_per_s2: ZAcceleration = None,
    period_s: Period = None,
    periods: Periods = None,
    realisations: Realisations = None,
    segments_per_second: Rate = None,
    height_mm: Height = None,
    flavor: FirmwareName = "",
    chip: Chips = None,
    shaper: ShaperBack = "",
    shaper_off: ShaperOff = None,
    print_file: Print = None,
    seed: Seed = None,
    as_json: AsJson = False,
) -> None:
    """Write the G-code of moves that are worth recording.

    For diagnose, at most 12 experiments and 5 minutes: hard zigzags, slow reversals, loops and multisines at several
    places, each made twice. For identify, a periodic excitation of each carriage or axis by itself. For check, half a
    minute in the middle of the bed. The capture commands are inside. With --print, a print is recorded while it prints;
    nothing is repeated then, and ffcomp diagnose needs --without-repeats.

    Example: ffcomp record plan -m mp-delta-pro -o moves.gcode
    """
    write_plan(
        as_json,
        machine=machine,
        output=output_file,
        purpose=purpose,
        at=at,
        kind=kind,
        axes=axes,
        seconds=seconds,
        repeats=repeats,
        lowest_hz=lowest_hz,
        highest_hz=highest_hz,
        amplitude_mm_per_s2=amplitude_mm_per_s2,
        z_acceleration_mm_per_s2=z_acceleration_mm_per_s2,
        period_s=period_s,
        periods=periods,
        realisations=realisations,
        segments_per_second=segments_per_second,
        height_mm=height_mm,
        flavor=flavor,
        chip=chip,
        shaper=shaper,
        shaper_off=shaper_off,
        print_file=print_file,
        seed=seed,
    )


def write_plan(as_json: bool, **options: Any) -> None:
    """Write the G-code and its plan, and say what comes next."""
    from ffcomp.cli.common import exit_codes, print_json

    with exit_codes():
        from ffcomp.record.planning import PlanRequest, plan_recording

        result = plan_recording(PlanRequest(**options))
        if as_json:
            print_json(result.to_dict())
        else:
            _report(result)


def _report(result: PlanResult) -> None:
    """Describe the file and the next steps."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    peaks = [result.peaks(each) for each in result.plan.experiments]
    columns = ("carriage mm/s", "m/s²", "nozzle mm/s", "m/s²") if peaks[0] else ("s",)
    table = Table("experiment", "at, mm", *columns, "microstep error")
    for each, peak in zip(result.plan.experiments, peaks, strict=True):
        cells = [f"{each.duration_s:.1f}"]
        if peak is not None:
            carriage = peak.carriage_velocity_mm_per_s, peak.carriage_acceleration_mm_per_s2 / 1e3
            nozzle = peak.nozzle_velocity_mm_per_s, peak.nozzle_acceleration_mm_per_s2 / 1e3
            cells = [text for v, a in (carriage, nozzle) for text in (f"{v:.0f}", f"{a:.1f}")]
        table.add_row(each.name, "{:g}, {:g}".format(*each.position_mm), *cells, f"{each.rounding:.0%}")
    console.print(table)
    for sentence in _sentences(result):
        console.print(sentence, highlight=False, soft_wrap=True)


def _sentences(result: PlanResult) -> Iterator[str]:
    plan, minutes = result.plan, result.plan.duration_s / 60
    yield from (f"warning: {warning}" for warning in result.warnings)
    often = f", {plan.repeats} times each" if plan.repeats > 1 else ""
    yield f"{result.output}: {len(plan.experiments)} experiments{often}, {minutes:.1f} min recorded."
    if places := result.missing_places_mm:
        options = " ".join(f"--at {x:g},{y:g}" for x, y in places)
        yield f"Places that would tell more: {options} (or --at line-of-action)."
    yield from result.firmware.restores()
    yield f"Bring back the captures, {len(result.captures)} for each accelerometer, and keep {result.plan_file}."
    yield f"Then: {result.next}"


@app.command("join")
def join(
    captures: Captures,
    plan_file: PlanFile,
    machine: MachineName,
    output: Folder,
    axes_map: CaptureAxes = None,
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Join captures with their commands: one measured run for each experiment and repeat.

    Klipper's and Kalico's captures are on the clock of the motion already. Others are aligned with it below 20 Hz. What
    cannot be joined is named with its reason; exit code 5 if nothing could be.

    Example: ffcomp record join captures/*.csv --plan moves.json -m my-delta.toml -o runs/
    """
    from ffcomp.cli.common import exit_codes, print_json, say

    with exit_codes():
        from ffcomp.record.axes import turn_of
        from ffcomp.record.join import join_captures
        from ffcomp.record.plan import load_plan
        from ffcomp.record.result import recording_lines
        from gcode.atomic_write import replace_atomically
        from models.file import load_machine

        made, loaded = load_plan(plan_file), load_machine(machine)
        found = join_captures(captures, made, loaded, turn_of(axes_map), lambda text: say(f"ffcomp: {text}", quiet))
        targets = [output / f"{each.name}.csv" for each in found.joined]
        if taken := [path for path in targets if path.exists() and not force]:
            raise typer.BadParameter(f"{taken[0]} exists already; give another --output, or --force.")
        if targets:
            output.mkdir(parents=True, exist_ok=True)
        for each, path in zip(found.joined, targets, strict=True):
            replace_atomically(path, recording_lines(each.recording))
        if as_json:
            print_json(found.to_dict([str(path) for path in targets]))
        else:
            _report_join(found, output, made, machine, loaded.vibration.diagnosable)
        for sentence in found.notes(made, loaded):
            say(f"ffcomp: {sentence}", quiet)
        found.check()


def _report_join(found: JoinResult, output: Path, plan: Plan, machine: str, diagnosable: bool) -> None:
    for each in found.joined:
        clock = each.clock
        print(
            f"{each.name}: offset {clock.offset_s:.6f} ± {clock.offset_sd_s:.6f} s, ratio {clock.ratio:.6f}, "
            f"correlation below 20 Hz {clock.correlation:.3f}"
        )
    for refused in found.refused:
        print(f"refused: {refused.file}: {refused.why}")
    if found.joined:
        axes = f"; axes {found.joined[0].axes_map}" if found.joined[0].axes_map else ""
        made = len({(each.experiment, each.repeat) for each in found.joined})
        print(f"{made} of {len(plan.runs())} executions joined in {output}{axes}.")
        if diagnosable:
            print(f"Then: ffcomp diagnose {output}/*.csv -m {machine}")
