"""Simulate a print or step timings."""

from __future__ import annotations

from pathlib import Path

from ffcomp.api.machines import load_machine
from ffcomp.compensation.placement import NOWHERE, Placement, place_print
from ffcomp.request import function
from ffcomp.simulation.command import Command
from ffcomp.simulation.request import SimulateRequest
from ffcomp.simulation.simulation import Simulation, read_command, simulate_command
from ffcomp.steps.archive import is_step_archive
from gcode.container import read_bytes
from gcode.embedded import already_processed
from gcode.text import check_regular
from models.machine import Machine


def read_simulation(request: SimulateRequest) -> tuple[Command, Machine, Machine, list[str]]:
    """Return the command to simulate, the machine that made it, the printer that moves, and warnings."""
    machine = load_machine(request.machine)
    plant = load_machine(request.plant) if request.plant else machine
    placed = _placement(request, machine)
    command, warnings = read_command(request.file, machine, placed.offset, request.flavor, request.plate)
    said = [machine.assumed, plant.assumed, placed.reason if placed.notable else "", *warnings]
    return command, machine, plant, list(dict.fromkeys(each for each in said if each))


def _placement(request: SimulateRequest, machine: Machine) -> Placement:
    """Choose the position of a sliced print; compensated prints and step timings contain theirs."""
    path = Path(request.file)
    check_regular(path)
    if is_step_archive(path) or already_processed(data := read_bytes(path, request.plate)) is not None:
        request.unused(f"is for sliced prints; {path} states its own", "offset_mm")
        return Placement(NOWHERE, "")
    if request.offset_mm is not None:
        return Placement(request.offset_mm, "")
    return place_print(data, str(path), machine, request.flavor)


def _simulate(request: SimulateRequest) -> Simulation:
    """Simulate a print or step timings on the nonlinear printer.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo, RequestError

    Examples
    --------
    >>> ffcomp.simulate("out.gcode", "mp-delta-pro", to_s=4.0).error_um.max()
    """
    return simulate_command(request, *read_simulation(request))


simulate = function(SimulateRequest, _simulate)
