"""`ffcomp simulate`: any command through the virtual printer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ffcomp.cli.command import Shown, verb
from ffcomp.cli.common import answer, print_json
from ffcomp.cli.progress import Progress
from ffcomp.errors import RequestError
from ffcomp.request import ADVANCED, OUTPUT, Option, Request
from ffcomp.simulation.request import SimulateRequest

if TYPE_CHECKING:
    from ffcomp.simulation.simulation import Simulation


@dataclass(frozen=True, kw_only=True)
class CapturesRequest(Request):
    """Captures to be written in place of a recording: what the printer's own accelerometer would record."""

    as_captures: Annotated[
        Path | None,
        Option(
            "Write what the printer's own accelerometer would record of a plan's G-code (with --plan).",
            OUTPUT,
            metavar="FOLDER",
        ),
    ] = None
    plan: Annotated[
        Path | None,
        Option("Plan (.json) of --as-captures, as record plan wrote it beside the G-code.", OUTPUT, metavar="FILE"),
    ] = None
    noise: Annotated[float, Option("Noise of captures, m/s² rms.", ADVANCED, metavar="M_PER_S2", low=0.0)] = 0.15
    tilt_deg: Annotated[float, Option("Tilt of the accelerometer, degrees.", ADVANCED, metavar="DEG")] = 2.0
    seed: Annotated[int, Option("Seed of the captures' noise, tilt and clock.", ADVANCED, metavar="N", low=0)] = 1

    def check(self) -> None:
        """Check that captures have a plan."""
        if self.as_captures is not None and self.plan is None:
            raise RequestError("--as-captures needs the plan of the G-code: --plan FILE.json.")


@verb
def simulate(request: SimulateRequest, captures: CapturesRequest, shown: Shown) -> None:
    """Simulate a print or step timings on the nonlinear printer.

    The printer has full kinematics, weight, drives, extruder and effects. ffcomp plans G-code as the firmware does
    and executes step timings microstep by microstep. It evaluates the response against the reference path, and writes
    it as a recording on request. With --as-captures it writes instead what an accelerometer would: gravity, noise,
    tilt and a clock of its own included; --rate is then the chip's.

    Example: ffcomp simulate sample_prints/ringing_tower.gcode -m mp-delta-pro --from 80 --to 90 -o run.csv
    """
    if captures.as_captures is not None:
        result = _write_captures(request, captures, captures.as_captures, shown.quiet)
        if shown.as_json:
            print_json(result)
        else:
            print(f"{len(result['captures'])} captures of {result['plan']}: {captures.as_captures}")
        return
    answer(_simulate(request, shown.quiet), shown.as_json)


def _write_captures(request: SimulateRequest, captures: CapturesRequest, folder: Path, quiet: bool) -> dict[str, Any]:
    """Write captures of a plan, and return the JSON object ffcomp-captures/1."""
    from ffcomp.api.machines import load_machine
    from ffcomp.record.virtual_sensor import Sensor, write_captures
    from gcode.dialects import KLIPPER
    from gcode.reader import read_program

    machine = load_machine(request.machine)
    plant = load_machine(request.plant) if request.plant else machine
    flavor = request.flavor or machine.flavor or KLIPPER
    file, plan = Path(request.file), captures.plan
    assert plan is not None  # the request is checked
    program = read_program(file.read_bytes(), str(file), flavor=flavor)
    sensor = Sensor(request.rate_hz, captures.noise, captures.tilt_deg, captures.seed)
    with Progress(1.0, quiet, "simulating") as progress:
        written = write_captures(plan, program, machine, plant, folder, sensor, flavor, progress)
    return {
        "schema": "ffcomp-captures/1",
        "input": str(file),  # the plan's G-code
        "plan": str(plan),
        "plant": {
            "name": plant.name,  # the machine file's `name`
            "sha256": plant.sha256,  # of the file's bytes
            "effects": list(plant.effects),  # list of text: its effects
        },
        "flavor": flavor,  # firmware in whose format the captures are
        "captures": [str(path) for path in written],  # list of text: the files
    }


def _simulate(request: SimulateRequest, quiet: bool) -> Simulation:
    from dataclasses import replace

    from ffcomp.api.simulation import read_simulation, run_simulation
    from models.machine import assumed_modes

    command, machine, plant, warnings = read_simulation(request)
    assumed = dict.fromkeys(filter(None, map(assumed_modes, (machine, plant))))
    parts = command.between(request.from_s, request.to_s)
    if request.recording is not None and len(parts) > 1:
        times = ", ".join(f"{begin:.3f} to {end:.3f} s" for _, begin, end in parts)
        raise RequestError(
            f"-o {request.recording}: something else moves the nozzle in between ({times}), and a run is one motion; "
            "choose with --from and --to."
        )
    with Progress(sum(end - begin for _, begin, end in parts), quiet, "simulating") as progress:
        done = run_simulation(replace(request, progress=progress), command, machine, plant)
    return replace(done, warnings=[*assumed, *warnings])
