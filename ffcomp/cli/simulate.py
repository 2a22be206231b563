"""`ffcomp simulate`: any command through the virtual printer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.cli.options import AsJson, Flavor, MachineName, Offset, Plant, Plate, Quiet, parsed_offset
from ffcomp.request import ACCURACY, ADVANCED, OUTPUT, SPEED

if TYPE_CHECKING:
    from ffcomp.record.virtual_sensor import Sensor
    from ffcomp.simulate.simulation import Request

File = Annotated[
    Path, typer.Argument(metavar="FILE", help="Print (sliced or compensated) or step-timing archive (.npz).")
]
Output = Annotated[
    Path | None,
    typer.Option(
        "--output-file",
        "-o",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="Write a recording (CSV) for ffcomp gap.",
    ),
]
Rate = Annotated[
    float, typer.Option(metavar="HZ", rich_help_panel=ACCURACY, help="Sample rate of the evaluation and the recording.")
]
From = Annotated[
    float,
    typer.Option(
        "--from",
        metavar="S",
        rich_help_panel=SPEED,
        help="Begin at this time of the command. A recording for ffcomp gap should begin at rest.",
    ),
]
To = Annotated[
    float,
    typer.Option("--to", metavar="S", rich_help_panel=SPEED, help="End at this time of the command. Default: the end."),
]
Signals = Annotated[
    str,
    typer.Option(metavar="KINDS", rich_help_panel=OUTPUT, help="Sensors in the recording: acc, pos or acc,pos."),
]
Gravity = Annotated[
    bool, typer.Option(rich_help_panel=ADVANCED, help="Let the weight deflect the belts and the extruder's mount.")
]
AsCaptures = Annotated[
    Path | None,
    typer.Option(
        "--as-captures",
        metavar="FOLDER",
        rich_help_panel=OUTPUT,
        help="Write what the printer's own accelerometer would record of a plan's G-code (with --plan).",
    ),
]
PlanOfCaptures = Annotated[
    Path | None,
    typer.Option(
        "--plan",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="Plan (.json) of --as-captures, as record plan wrote it beside the G-code.",
    ),
]
Noise = Annotated[
    float, typer.Option(metavar="M_PER_S2", rich_help_panel=ADVANCED, min=0.0, help="Noise of captures, m/s² rms.")
]
Tilt = Annotated[
    float,
    typer.Option("--tilt-deg", metavar="DEG", rich_help_panel=ADVANCED, help="Tilt of the accelerometer, degrees."),
]
Seed = Annotated[
    int, typer.Option(metavar="N", rich_help_panel=ADVANCED, min=0, help="Seed of the captures' noise, tilt and clock.")
]


def simulate(
    file: File,
    machine: MachineName,
    plant: Plant = "",
    output_file: Output = None,
    rate: Rate = 1600.0,
    from_s: From = 0.0,
    to_s: To = float("inf"),
    signals: Signals = "acc,pos",
    gravity: Gravity = True,
    offset_mm: Offset = "0,0",
    flavor: Flavor = "",
    plate: Plate = None,
    as_captures: AsCaptures = None,
    plan: PlanOfCaptures = None,
    noise: Noise = 0.15,
    tilt_deg: Tilt = 2.0,
    seed: Seed = 1,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a print or step timings on the nonlinear printer.

    The printer has full kinematics, weight, drives, extruder and effects. ffcomp plans G-code as the firmware does
    and executes step timings microstep by microstep. It evaluates the response against the reference path, and writes
    it as a recording on request. With --as-captures it writes instead what an accelerometer would: gravity, noise,
    tilt and a clock of its own included; --rate is then the chip's.

    Example: ffcomp simulate sample_prints/ringing_tower.gcode -m mp-delta-pro --from 80 --to 90 -o run.csv
    """
    from ffcomp.cli.common import exit_codes, print_json

    with exit_codes():
        if as_captures is not None:
            from ffcomp.record.virtual_sensor import Sensor

            sensor = Sensor(rate, noise, tilt_deg, seed)
            result = _captures(file, machine, plant, as_captures, plan, sensor, flavor, quiet)
            if as_json:
                print_json(result)
            elif not quiet:
                print(f"{len(result['captures'])} captures of {result['plan']}: {as_captures}")
            return
        request = _request(rate, from_s, to_s, gravity, signals)
        _check_target(file, output_file)
        result = _simulate(file, machine, plant, output_file, request, offset_mm, flavor, plate, quiet)
        if as_json:
            print_json(result)
        elif not quiet:
            _print(result)


def _captures(
    file: Path,
    machine_name: str,
    plant_name: str,
    folder: Path,
    plan: Path | None,
    sensor: Sensor,
    flavor: str,
    quiet: bool,
) -> dict[str, Any]:
    """Write captures of a plan, and return the JSON object ffcomp-captures/1."""
    from ffcomp.cli.common import Progress
    from ffcomp.record.virtual_sensor import write_captures
    from gcode.dialects import KLIPPER
    from gcode.reader import read_program
    from models.file import load_machine

    if plan is None:
        raise typer.BadParameter("--as-captures needs the plan of the G-code: --plan FILE.json.")
    machine = load_machine(machine_name)
    plant = load_machine(plant_name) if plant_name else machine
    spoken = flavor or machine.flavor or KLIPPER
    program = read_program(file.read_bytes(), str(file), flavor=spoken)
    with Progress(1.0, quiet, "simulating") as progress:
        written = write_captures(plan, program, machine, plant, folder, sensor, spoken, progress)
    return {
        "schema": "ffcomp-captures/1",
        "input": str(file),
        "plan": str(plan),
        "plant": {"name": plant.name, "sha256": plant.sha256, "effects": list(plant.effects)},
        "flavor": spoken,
        "captures": [str(path) for path in written],
    }


def _request(rate: float, from_s: float, to_s: float, gravity: bool, signals: str) -> Request:
    from ffcomp.measurement.clock import HIGHEST_RATE_HZ, LOWEST_RATE_HZ
    from ffcomp.simulate.simulation import KINDS, Request

    if not LOWEST_RATE_HZ <= rate <= HIGHEST_RATE_HZ:
        raise typer.BadParameter(f"--rate {rate:g}: between {LOWEST_RATE_HZ:g} and {HIGHEST_RATE_HZ:g} Hz.")
    if not 0.0 <= from_s < to_s:
        raise typer.BadParameter(f"--from {from_s:g} --to {to_s:g}: two times in s, the first not below 0, in order.")
    kinds = tuple(dict.fromkeys(signals.split(",")))
    if not set(kinds) <= set(KINDS):
        raise typer.BadParameter(f"--signals {signals!r}: {', '.join(KINDS)}, or both with a comma between them.")
    return Request(rate, from_s, to_s, gravity, kinds)


def _check_target(file: Path, target: Path | None) -> None:
    if target is not None and target.resolve() == file.resolve():
        raise typer.BadParameter(f"-o {target}: this is the command itself; the run needs a file of its own.")


def _simulate(
    file: Path,
    machine_name: str,
    plant_name: str,
    target: Path | None,
    request: Request,
    offset: str,
    flavor: str,
    plate: int | None,
    quiet: bool,
) -> dict[str, Any]:
    from ffcomp.cli.common import Progress, say, say_assumed
    from ffcomp.simulate.simulation import read_command, simulate_command
    from models.file import load_machine

    machine = load_machine(machine_name)
    plant = load_machine(plant_name) if plant_name else machine
    say_assumed([machine, plant], quiet)
    command, warnings = read_command(file, machine, parsed_offset(offset), flavor, plate)
    for warning in warnings:
        say(f"ffcomp: {warning}", quiet)
    parts = command.between(request.from_s, request.to_s)
    if target is not None and len(parts) > 1:
        times = ", ".join(f"{begin:.3f} to {end:.3f} s" for _, begin, end in parts)
        raise typer.BadParameter(
            f"-o {target}: something else moves the nozzle in between ({times}), and a run is one motion; choose with "
            "--from and --to."
        )
    with Progress(sum(end - begin for _, begin, end in parts), quiet, "simulating") as progress:
        options: dict[str, Any] = {"path": str(file), "target": target, "progress": progress}
        found = simulate_command(command, machine, plant, request, **options)
    return {
        "schema": "ffcomp-simulate/1",
        "input": str(file),
        "output": None if target is None else str(target),
        **found.to_dict(),
        "warnings": warnings,
    }


def _print(result: dict[str, Any]) -> None:
    track = result["track"]
    print(
        f"{result['simulated_s']:.1f} s of motion on {result['plant']['name']} (effects: "
        f"{', '.join(result['effects']) or 'none'}), {result['wall_s']:.1f} s: {result['print_s_per_wall_s']:.0f} "
        "times faster than printing."
    )
    print(f"Against {result['reference']}:")
    print(
        f"  contour   rms {track['contour_rms_um']:.2f} µm, 99 % below {track['contour_p99_um']:.1f} µm, "
        f"largest {track['contour_max_um']:.1f} µm"
    )
    print(
        f"  tracking  rms {track['tracking_rms_um']:.1f} µm, of it {track['tracking_rms_no_delay_um']:.2f} µm beside a "
        f"delay of {1e3 * track['delay_s']:.3f} ms"
    )
    print(
        f"  carriages asked for {result['peak_carriage_velocity_mm_per_s']:.0f} mm/s and "
        f"{track['peak_command_acceleration_mm_per_s2'] / 1e3:.1f} m/s² at most"
    )
    if result["output"] is not None:
        print(f"{result['rows']} samples at {result['rate_hz']:g} Hz: {result['output']}")
