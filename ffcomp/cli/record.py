"""`ffcomp record`: moves for the printer's own sensor, and its captures joined with their command."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.cli.options import AsJson, CaptureAxes, Force, MachineName, PlanOutput, Quiet, check_choice
from ffcomp.request import ACCURACY, ADVANCED, MACHINE, OUTPUT

if TYPE_CHECKING:
    from ffcomp.record.firmware import Firmware
    from ffcomp.record.plan import MovesPlan
    from ffcomp.record.result import JoinResult

app = typer.Typer(
    no_args_is_help=True,
    help="Record the printer's vibrations with its own accelerometer.\n\n"
    "First ffcomp record plan, then run its G-code, then give the captures to ffcomp diagnose with --plan; or keep "
    "them as measured runs with ffcomp record join.",
)

At = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y",
        rich_help_panel=MACHINE,
        help="Place of experiments, mm. May be repeated; places are 40 mm apart or more. Default: the centre, and "
        "three places around it.",
    ),
]
Seconds = Annotated[
    float,
    typer.Option(metavar="S", rich_help_panel=ACCURACY, min=2.0, max=20.0, help="Duration of an experiment, about."),
]
Repeats = Annotated[
    int,
    typer.Option(
        metavar="N", rich_help_panel=ACCURACY, min=1, max=9, help="How often each is made. Repeats show the noise."
    ),
]
Amplitude = Annotated[
    float | None,
    typer.Option(
        "--amplitude-mm-per-s2",
        metavar="A",
        rich_help_panel=ACCURACY,
        min=1.0,
        help="Acceleration of the nozzle. Default: the machine file's limit.",
    ),
]
Height = Annotated[
    float, typer.Option("--height-mm", metavar="MM", rich_help_panel=MACHINE, help="Nozzle height above the bed.")
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
Print = Annotated[
    Path | None,
    typer.Option(
        "--print",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="Record this print instead of ffcomp's own moves: up to 12 stretches of its first layers. Print the file "
        "that -o names.",
    ),
]
Kind = Annotated[
    list[str] | None,
    typer.Option(
        "--kind",
        metavar="NAME",
        rich_help_panel=ADVANCED,
        help="Only such moves: zigzag, reversals, loop or multisine. May be repeated. Default: all of them.",
    ),
]
Seed = Annotated[int, typer.Option(metavar="N", rich_help_panel=ADVANCED, min=0, help="Seed of the moves.")]


@app.command("plan")
def plan(
    machine: MachineName,
    output_file: PlanOutput,
    at: At = None,
    seconds: Seconds = 4.0,
    repeats: Repeats = 2,
    amplitude_mm_per_s2: Amplitude = None,
    height_mm: Height = 30.0,
    flavor: FirmwareName = "",
    chip: Chips = None,
    shaper: ShaperBack = "",
    print_file: Print = None,
    kind: Kind = None,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Write the G-code of moves that are worth recording.

    At most 12 experiments and 5 minutes: hard zigzags, slow reversals, loops and multisines at several places, each
    made twice. The capture commands are inside. With --print, a print is recorded while it prints; nothing is repeated
    then, and ffcomp diagnose needs --without-repeats.

    Example: ffcomp record plan -m mp-delta-pro -o moves.gcode
    """
    from ffcomp.cli.common import exit_codes
    from gcode.dialects import FLAVORS, KLIPPER

    if flavor:
        check_choice("--flavor", flavor, sorted(FLAVORS))
    from ffcomp.record.moves import KINDS

    for each in kind or []:
        check_choice("--kind", each, list(KINDS))
    account = account_of(output_file)
    with exit_codes():
        from ffcomp.record.firmware import DEFAULT_CHIPS, Firmware
        from ffcomp.record.gcode_text import gcode_lines
        from ffcomp.record.plan import Request, make_plan
        from ffcomp.record.prints import plan_print, print_lines
        from models.file import load_machine

        loaded = load_machine(machine)
        request = Request(
            places_mm=[pair("--at", text) for text in at or []],
            height_mm=height_mm,
            seconds=seconds,
            repeats=repeats,
            acceleration_mm_per_s2=amplitude_mm_per_s2,
            seed=seed,
            kinds=list(dict.fromkeys(kind or KINDS)),
        )
        spoken = flavor or loaded.flavor or KLIPPER
        firmware = Firmware(spoken, chip or DEFAULT_CHIPS[spoken], pair("--shaper", shaper) if shaper else None)
        if print_file is None:
            made = make_plan(loaded, request)
            lines = gcode_lines(made, loaded, firmware)
        else:
            made, program = plan_print(print_file, loaded, spoken)
            lines = print_lines(made, program, firmware)
        then = _next(made, account, machine, loaded.vibration.diagnosable)
        finish_plan(made, lines, firmware, output_file, then, as_json)


def account_of(output_file: Path) -> Path:
    """Return where the plan of a G-code file is written."""
    account = output_file.with_suffix(".json")
    if account == output_file:
        raise typer.BadParameter(f"-o {output_file}: the G-code needs another ending, for .json is that of its plan.")
    return account


def finish_plan(
    made: MovesPlan, lines: Iterable[bytes], firmware: Firmware, target: Path, then: str, as_json: bool
) -> None:
    """Write the G-code and its plan, and say what comes next."""
    from ffcomp.cli.common import print_json
    from ffcomp.record.plan_files import save_plan
    from gcode.atomic_write import replace_atomically

    account = account_of(target)
    replace_atomically(target, lines)
    save_plan(made, account)
    result = _result(made, firmware, target, account, then)
    if as_json:
        print_json(result)
    else:
        _report(result)


def pair(option: str, text: str) -> tuple[float, float]:
    """Parse the two numbers of an option."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{option} {text!r}: two numbers with a comma between them.") from None
    return x, y


def _next(made: MovesPlan, account: Path, machine: str, diagnosable: bool) -> str:
    if not diagnosable:
        return f"ffcomp record join CAPTURES --plan {account} -m {machine} -o runs/"
    repeated = "" if made.repeats > 1 else " --without-repeats"
    return f"ffcomp diagnose CAPTURES --plan {account} -m {machine}{repeated}"


def _result(made: MovesPlan, firmware: Firmware, target: Path, account: Path, then: str) -> dict[str, Any]:
    from ffcomp.record.plan_files import capture_name

    experiments = [
        {
            "name": each.name,
            "kind": each.kind,
            "position_mm": each.position_mm,
            "duration_s": each.duration_s,
            "moves": len(each.motion.speed),
            "microstep_error": each.rounding,
        }
        for each in made.experiments
    ]
    return {
        "schema": "ffcomp-record-plan/1",
        "machine": {"name": made.machine, "sha256": made.machine_sha256},
        "output": str(target),
        "plan": str(account),
        "flavor": firmware.flavor,
        "duration_s": made.duration_s,
        "repeats": made.repeats,
        "experiments": experiments,
        "captures": [capture_name(each.name, repeat) for each, repeat in made.runs()],
        "restores": firmware.restores(),
        "warnings": _warnings(experiments),
        "next": then,
    }


def _warnings(experiments: list[dict[str, Any]]) -> list[str]:
    from ffcomp.record.plan import MOST_ROUNDING

    coarse = [each for each in experiments if each["microstep_error"] > MOST_ROUNDING]
    if not coarse:
        return []
    worst = max(coarse, key=lambda each: float(each["microstep_error"]))
    return [
        f"In {len(coarse)} of {len(experiments)} experiments rounding to microsteps is more than {MOST_ROUNDING:.0%} "
        f"of the command; most in {worst['name']}, {worst['microstep_error']:.0%}. Finer microsteps or higher limits "
        "in the machine file make it smaller."
    ]


def _report(result: dict[str, Any]) -> None:
    """Describe the file and the next steps."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table("experiment", "at, mm", "s", "microstep error")
    for each in result["experiments"]:
        place = "{:g}, {:g}".format(*each["position_mm"])
        table.add_row(each["name"], place, f"{each['duration_s']:.1f}", f"{100 * each['microstep_error']:.0f} %")
    console.print(table)
    for sentence in _sentences(result):
        console.print(sentence, highlight=False, soft_wrap=True)


def _sentences(result: dict[str, Any]) -> list[str]:
    count, minutes = len(result["experiments"]), result["duration_s"] / 60
    return [
        *(f"warning: {warning}" for warning in result["warnings"]),
        f"{result['output']}: {count} experiments, {result['repeats']} times each, {minutes:.1f} min recorded.",
        *result["restores"],
        f"Bring back the captures, {len(result['captures'])} for each accelerometer, and keep {result['plan']}.",
        f"Then: {result['next']}",
    ]


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
        from ffcomp.record.plan_files import load_moves
        from ffcomp.record.result import recording_lines
        from gcode.atomic_write import replace_atomically
        from models.file import load_machine

        made, loaded = load_moves(plan_file), load_machine(machine)
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


def _report_join(found: JoinResult, output: Path, plan: MovesPlan, machine: str, diagnosable: bool) -> None:
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
