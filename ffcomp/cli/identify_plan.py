"""`ffcomp identify plan`: G-code that shakes the printer, for a user with an accelerometer and no laboratory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.cli.options import AsJson, MachineName, PlanOutput, check_choice
from ffcomp.request import ACCURACY, ADVANCED, MACHINE

if TYPE_CHECKING:
    from ffcomp.identify.experiment import Plan, Request
    from models.machine import Machine

LINE_OF_ACTION, CENTRE = "line-of-action", "centre"

At = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y",
        rich_help_panel=MACHINE,
        help="Position to excite at, mm. May be repeated. line-of-action: three positions away from each tower of a "
        "delta, where the dynamics differ most. Default: centre, the middle of the bed.",
    ),
]
Kind = Annotated[
    str,
    typer.Option(
        metavar="KIND",
        rich_help_panel=ADVANCED,
        help="Excitation: multisine (low peaks, whole periods), sweep or log-sweep.",
    ),
]
Directions = Annotated[
    str | None,
    typer.Option(
        "--axes",
        metavar="AXES",
        rich_help_panel=MACHINE,
        help="towers: each carriage alone (default of a delta); all: towers and xyz; or the nozzle along x, y, z, xy "
        "(default of cartesian and CoreXY) or xyz.",
    ),
]
Lowest = Annotated[float, typer.Option(metavar="HZ", rich_help_panel=ACCURACY, min=0.5, help="Lowest frequency.")]
Highest = Annotated[float, typer.Option(metavar="HZ", rich_help_panel=ACCURACY, min=1.0, help="Highest frequency.")]
Amplitude = Annotated[
    float | None,
    typer.Option(
        "--amplitude-mm-per-s2",
        metavar="A",
        rich_help_panel=ACCURACY,
        min=1.0,
        help="Peak acceleration of the excitation. Default: a safe share of the machine's limits.",
    ),
]
ZAcceleration = Annotated[
    float | None,
    typer.Option(
        "--z-acceleration-mm-per-s2",
        metavar="A",
        rich_help_panel=MACHINE,
        min=1.0,
        help="The firmware's limit in Z (Klipper: max_z_accel). Default: the machine file's acceleration.",
    ),
]
Period = Annotated[
    float,
    typer.Option(
        metavar="S", rich_help_panel=ADVANCED, min=2.0, max=60.0, help="Period. Its inverse is the frequency step."
    ),
]
Periods = Annotated[
    int,
    typer.Option(
        metavar="N", rich_help_panel=ADVANCED, min=1, help="Periods to average, after a first one that settles."
    ),
]
Realisations = Annotated[
    int,
    typer.Option(
        metavar="N", rich_help_panel=ADVANCED, min=1, help="Repetitions of the multisine with other random phases."
    ),
]
Height = Annotated[
    float, typer.Option("--height-mm", metavar="MM", rich_help_panel=MACHINE, help="Nozzle height above the bed.")
]
Firmware = Annotated[
    str, typer.Option(metavar="NAME", rich_help_panel=MACHINE, help="Firmware: klipper, marlin or reprapfirmware.")
]
Chips = Annotated[
    list[str] | None,
    typer.Option(
        "--chip",
        metavar="NAME",
        rich_help_panel=MACHINE,
        help="Klipper's name of an accelerometer. May be repeated. Default: adxl345.",
    ),
]
Rate = Annotated[
    float,
    typer.Option(
        "--segments-per-second",
        metavar="RATE",
        rich_help_panel=ADVANCED,
        min=125.0,
        max=500.0,
        help="Segment rate. It rises if the highest frequency needs more.",
    ),
]
ShaperOff = Annotated[
    bool, typer.Option(rich_help_panel=MACHINE, help="Switch the firmware's input shaper off at the beginning.")
]
Seed = Annotated[int, typer.Option(metavar="N", rich_help_panel=ADVANCED, min=0, help="Seed of the random phases.")]


def plan(
    machine: MachineName,
    output_file: PlanOutput,
    at: At = None,
    kind: Kind = "multisine",
    axes: Directions = None,
    lowest_hz: Lowest = 5.0,
    highest_hz: Highest = 150.0,
    amplitude_mm_per_s2: Amplitude = None,
    z_acceleration_mm_per_s2: ZAcceleration = None,
    period_s: Period = 4.0,
    periods: Periods = 6,
    realisations: Realisations = 1,
    height_mm: Height = 50.0,
    flavor: Firmware = "klipper",
    chip: Chips = None,
    segments_per_second: Rate = 250.0,
    shaper_off: ShaperOff = True,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Write the G-code of an identification experiment.

    Run the file on the cold printer with an accelerometer on the nozzle holder, then pass the captures and the plan
    to ffcomp identify fit.

    Example: ffcomp identify plan -m mp-delta-pro -o excite.gcode --at 0,0 --at line-of-action
    """
    from ffcomp.cli.common import exit_codes, print_json
    from gcode.dialects import FLAVORS

    check_choice("--flavor", flavor, sorted(FLAVORS))
    with exit_codes():
        from ffcomp.identify.experiment import Request, make_plan
        from ffcomp.identify.multisine import KINDS
        from models.file import load_machine

        check_choice("--kind", kind, list(KINDS))
        loaded = load_machine(machine)
        request = Request(
            places_mm=_places(at or [CENTRE], loaded),
            height_mm=height_mm,
            directions=_directions(axes, loaded),
            kind=kind,
            lowest_hz=lowest_hz,
            highest_hz=highest_hz,
            period_s=period_s,
            periods=periods,
            realisations=realisations,
            acceleration_mm_per_s2=amplitude_mm_per_s2,
            z_acceleration_mm_per_s2=z_acceleration_mm_per_s2,
            segments_per_second=segments_per_second,
            seed=seed,
        )
        made = make_plan(loaded, request)
        account = _write(made, loaded, output_file, flavor, chip or ["adxl345"], shaper_off)
        result = _result(made, loaded, request, output_file, account, flavor)
        result["next"] = f"ffcomp identify fit -m {machine} --plan {account} CAPTURES"
        if as_json:
            print_json(result)
        else:
            _report(result, shaper_off)


def _directions(axes: str | None, machine: Machine) -> tuple[str, ...]:
    """Choose the directions to excite; the first group is the machine's default."""
    groups = machine.kinematics.excitation_directions
    chosen = axes or next(iter(groups))
    check_choice("--axes", chosen, list(groups))
    return groups[chosen]


def _places(texts: list[str], machine: Machine) -> list[tuple[float, float]]:
    """mm; each place once, in the order given."""
    from ffcomp.identify.experiment import line_of_action

    found: list[tuple[float, float]] = []
    for text in texts:
        if text == CENTRE:
            found.append(machine.kinematics.centre_mm)
        elif text == LINE_OF_ACTION and not machine.kinematics.tower_directions:
            raise typer.BadParameter(f"--at {text}: that is a delta's; straight axes answer alike everywhere.")
        else:
            found += line_of_action(machine.kinematics) if text == LINE_OF_ACTION else [_place(text)]
    return list(dict.fromkeys(found))


def _recommended(machine: Machine) -> list[tuple[float, float]]:
    """Places that tell all; straight axes answer alike everywhere."""
    from ffcomp.identify.experiment import line_of_action

    return [machine.kinematics.centre_mm, *line_of_action(machine.kinematics)]


def _place(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        rule = f"two numbers with a comma between them, in mm, {CENTRE} or {LINE_OF_ACTION}"
        raise typer.BadParameter(f"--at {text!r}: {rule}.") from None
    return x, y


def _write(made: Plan, machine: Machine, target: Path, flavor: str, chips: list[str], shaper_off: bool) -> Path:
    """Both files; the path of the account."""
    from ffcomp.identify.experiment_files import gcode_lines, save_plan
    from gcode.atomic_write import replace_atomically

    account = target.with_suffix(".json")
    if account == target:
        raise typer.BadParameter(f"-o {target}: the G-code needs another ending, for .json is that of its account.")
    save_plan(made, account)
    replace_atomically(target, gcode_lines(made, machine, flavor, chips, shaper_off))
    return account


def _result(made: Plan, machine: Machine, request: Request, target: Path, account: Path, flavor: str) -> dict[str, Any]:
    from dataclasses import asdict

    from ffcomp.identify.experiment import microstep_error
    from ffcomp.identify.experiment_files import capture_name, duration_s
    from models.provenance import identity

    experiments = [
        {
            "name": each.name,
            "direction": each.direction,
            "position_mm": each.position_mm,
            "duration_s": each.duration_s,
            "segments": len(each.vertices_mm) - 1,
            "peaks": asdict(each.peaks),
            "microstep_error": microstep_error(each, machine.steps.per_motor),
            "capture": capture_name(each),
        }
        for each in made.experiments
    ]
    return {
        "schema": "ffcomp-identify-plan/1",
        "machine": identity(machine),
        "output": str(target),
        "account": str(account),
        "flavor": flavor,
        "duration_s": duration_s(made),
        "experiments": experiments,
        "warnings": _warnings(experiments),
        "recommended_places_mm": _recommended(machine),
        "places_mm": list(request.places_mm),
    }


def _warnings(experiments: list[dict[str, Any]]) -> list[str]:
    from ffcomp.identify.experiment import COARSE

    coarse = [each for each in experiments if each["microstep_error"] > COARSE]
    if not coarse:
        return []
    worst = max(coarse, key=lambda each: float(each["microstep_error"]))
    return [
        f"In {len(coarse)} of {len(experiments)} experiments rounding to microsteps spoils the upper half of the band; "
        f"most in {worst['name']}, where the error is {100 * worst['microstep_error']:.0f} % of the command. A larger "
        "--amplitude-mm-per-s2, a lower --highest-hz or finer microsteps make it smaller; where the firmware's limit "
        "in Z stands against the amplitude, raise it there and say so with --z-acceleration-mm-per-s2."
    ]


def _report(result: dict[str, Any], shaper_off: bool) -> None:
    """Describe the file and the next steps."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    table = Table("ffcomp-", "at, mm", "carriage mm/s", "m/s²", "nozzle mm/s", "m/s²", "microstep error")
    for each in result["experiments"]:
        name = each["name"].removeprefix("ffcomp-")
        place, error = "{:g}, {:g}".format(*each["position_mm"]), f"{100 * each['microstep_error']:.0f} %"
        table.add_row(name, place, *_peaks(each["peaks"], "carriage"), *_peaks(each["peaks"], "nozzle"), error)
    console.print(table)
    for sentence in _sentences(result, shaper_off):
        console.print(sentence, highlight=False, soft_wrap=True)


def _peaks(peaks: dict[str, float], what: str) -> tuple[str, str]:
    return f"{peaks[f'{what}_velocity_mm_per_s']:.0f}", f"{peaks[f'{what}_acceleration_mm_per_s2'] / 1e3:.1f}"


def _sentences(result: dict[str, Any], shaper_off: bool) -> list[str]:
    minutes = result["duration_s"] / 60
    sentences = [f"warning: {warning}" for warning in result["warnings"]]
    sentences.append(f"{result['output']}: {len(result['experiments'])} experiments, {minutes:.1f} min and homing.")
    missing = [place for place in result["recommended_places_mm"] if place not in result["places_mm"]]
    if missing:
        options = " ".join(f"--at {x:g},{y:g}" for x, y in missing)
        sentences.append(f"Places that would tell more: {options} (or --at {LINE_OF_ACTION}).")
    if shaper_off:
        sentences.append("It switches the input shaper off, until the firmware is restarted.")
    bring = "Bring back the captures, *-ffcomp-*.csv, one of each experiment and accelerometer;"
    sentences.append(f"{bring} keep {result['account']}.")
    sentences.append(f"Then: {result['next']}")
    return sentences
