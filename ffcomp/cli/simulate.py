"""`ffcomp simulate`: any command through the virtual printer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from ffcomp.cli.command import verb
from ffcomp.cli.progress import Progress
from ffcomp.errors import RequestError
from ffcomp.numerics.serialise import keys
from ffcomp.request import ADVANCED, OUTPUT, Option, Request
from ffcomp.result import Fact, Result
from ffcomp.simulation.request import SimulateRequest

if TYPE_CHECKING:
    from models.machine import Machine


@dataclass(frozen=True, kw_only=True)
class CapturesRequest(Request):
    """Captures to be written in place of a recording: what the printer's own accelerometer would record."""

    as_captures: Annotated[
        Path | None,
        Option(
            "Write what the printer's own accelerometer would record of a plan's G-code (with --plan).",
            OUTPUT,
            metavar="FOLDER",
            writes="folder",
        ),
    ] = None
    plan: Annotated[
        Path | None,
        Option("Plan (.json) for --as-captures, which record plan wrote next to the G-code.", OUTPUT, metavar="FILE"),
    ] = None
    noise: Annotated[float, Option("Noise of captures, m/s² rms.", ADVANCED, metavar="M_PER_S2", low=0.0)] = 0.15
    tilt_deg: Annotated[float, Option("Tilt of the accelerometer, degrees.", ADVANCED, metavar="DEG")] = 2.0
    seed: Annotated[int, Option("Seed of the captures' noise, tilt and clock.", ADVANCED, metavar="N", low=0)] = 1

    def check(self) -> None:
        """Check that captures have a plan."""
        if self.as_captures is None:
            self.unused("is for --as-captures", "plan", "noise", "tilt_deg", "seed")
        elif self.plan is None:
            raise RequestError("--as-captures needs the plan of the G-code: --plan FILE.json.")


@verb
def simulate(request: SimulateRequest, captures: CapturesRequest) -> Result:
    """Simulate a print or step timings on the nonlinear printer.

    The printer has full kinematics, weight, drives, extruder and effects. ffcomp plans G-code as the firmware does
    and executes step timings microstep by microstep. It evaluates the response against the reference path, and writes
    it as a recording on request. With --as-captures it writes the captures of an accelerometer instead, with gravity,
    noise, tilt and a clock error; --rate is then the accelerometer's.

    Example: ffcomp simulate sample_prints/ringing_tower.gcode -m mp-delta-pro --from 80 --to 90 -o run.csv
    """
    if captures.as_captures is not None:
        return _write_captures(request, captures, captures.as_captures)
    from ffcomp.api.simulation import read_simulation
    from ffcomp.simulation.simulation import simulate_command

    command, machine, plant, warnings = read_simulation(request)
    parts = command.between(request.from_s, request.to_s)
    if request.recording is not None and len(parts) > 1:
        times = ", ".join(f"{begin:.3f} to {end:.3f} s" for _, begin, end in parts)
        raise RequestError(
            f"-o {request.recording}: something else moves the nozzle in between ({times}), and a run is one motion; "
            "choose with --from and --to."
        )
    with Progress(sum(end - begin for _, begin, end in parts), "simulating") as progress:
        return simulate_command(replace(request, progress=progress), command, machine, plant, warnings)


@dataclass(frozen=True, eq=False, repr=False)
class Captures(Result):
    """Captures that were written in place of a printer's."""

    schema = "ffcomp-captures/1"
    json_keys: ClassVar = keys("input", "plan", "plant", "flavor", "captures")

    input: Path
    plan: Path
    plant: Machine
    flavor: str
    captures: Sequence[Path]

    @property
    def headline(self) -> str:
        """How many there are, and where."""
        return f"{len(self.captures)} captures of {self.plan} are in {self.captures[0].parent}."

    @property
    def facts(self) -> list[Fact]:
        """What they would be of."""
        return [("Printer", self.plant.name), ("Firmware", self.flavor)]


def _write_captures(request: SimulateRequest, captures: CapturesRequest, folder: Path) -> Captures:
    from ffcomp.api.machines import load_machine
    from ffcomp.record.virtual_sensor import Sensor, write_captures
    from gcode.dialect import KLIPPER
    from gcode.reader import read_program

    machine = load_machine(request.machine)
    plant = load_machine(request.plant) if request.plant else machine
    flavor = request.flavor or machine.flavor or KLIPPER
    file, plan = Path(request.file), captures.plan
    assert plan is not None  # the request is checked
    program = read_program(file.read_bytes(), str(file), flavor=flavor)
    sensor = Sensor(request.rate_hz, captures.noise, captures.tilt_deg, captures.seed)
    with Progress(1.0, "simulating") as progress:
        written = write_captures(plan, program, machine, plant, folder, sensor, flavor, progress)
    return Captures(file, plan, plant, flavor, written)
