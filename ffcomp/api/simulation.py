"""Simulate a print or step timings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffcomp.api.machines import load_machine
from ffcomp.compensation.placement import NOWHERE, Placement, place_print
from ffcomp.errors import missing_extras_explained
from ffcomp.request import function
from ffcomp.simulation.command import Command
from ffcomp.simulation.request import SimulateRequest
from ffcomp.simulation.simulation import Request as Part
from ffcomp.simulation.simulation import SimulationResult, read_command, simulate_command
from ffcomp.steps.archive import is_step_archive
from gcode.container import read_bytes
from gcode.embedded import already_processed
from gcode.text import check_regular
from models.arrays import FloatArray
from models.machine import Machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Simulation(SimulationResult):
    """A simulated command: arrays `time_s`, `reference_mm`, `nozzle_mm` and `error_um`, and their `track`."""

    @missing_extras_explained()
    def plot(self) -> Figure:
        """Draw the position of the largest error close up, and the contour error along the time."""
        from ffcomp.report.show import simulation_figure

        return simulation_figure(self)

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame with a row for each sample; needs pandas."""
        import pandas as pd

        columns: dict[str, FloatArray] = {"time_s": self.time_s}
        for name, points in (("reference", self.reference_mm), ("nozzle", self.nozzle_mm)):
            columns |= {f"{name}_{axis}_mm": points[:, k] for k, axis in enumerate("xyz")}
        return pd.DataFrame({**columns, "error_um": self.error_um})


def read_simulation(request: SimulateRequest) -> tuple[Command, Machine, Machine, list[str]]:
    """Read what is to be simulated: the command, the machine that made it, the printer that moves, and warnings."""
    machine = load_machine(request.machine)
    plant = load_machine(request.plant) if request.plant else machine
    placed = _placement(request, machine)
    command, warnings = read_command(request.file, machine, placed.offset, request.flavor, request.plate)
    return command, machine, plant, [*([placed.reason] if placed.notable else []), *warnings]


def _placement(request: SimulateRequest, machine: Machine) -> Placement:
    """Choose where a sliced print lies; a compensated one and step timings say so themselves."""
    path = Path(request.file)
    if request.offset_mm is not None:
        return Placement(request.offset_mm, "")
    check_regular(path)
    if is_step_archive(path) or already_processed(data := read_bytes(path, request.plate)) is not None:
        return Placement(NOWHERE, "")
    return place_print(data, str(path), machine, request.flavor)


def run_simulation(request: SimulateRequest, command: Command, machine: Machine, plant: Machine) -> Simulation:
    """Simulate a command, and record it where that is requested."""
    part = Part(request.rate_hz, request.from_s, request.to_s, request.gravity, request.signals)
    target = None if request.recording is None else Path(request.recording)
    result = simulate_command(
        command, machine, plant, part, path=str(request.file), target=target, progress=request.progress
    )
    return Simulation(**{name: getattr(result, name) for name in SimulationResult.__dataclass_fields__})


def _simulate(request: SimulateRequest) -> Simulation:
    """Simulate a print or step timings on the nonlinear printer.

    Parameters
    ----------
    progress : Called with the print seconds done so far.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo, RequestError
    """
    command, machine, plant, _ = read_simulation(request)
    return run_simulation(request, command, machine, plant)


simulate = function(SimulateRequest, _simulate)
