"""Estimate how long a print takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ffcomp.api.machines import load_machine, machine_of
from ffcomp.errors import RequestError
from ffcomp.estimation import engine as estimation
from ffcomp.estimation.request import EstimateRequest
from ffcomp.request import function
from gcode.container import Source, opened_print
from models.machine import Machine


def estimate_request(request: EstimateRequest) -> estimation.Estimate:
    """Estimate how long a print takes.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo

    Examples
    --------
    >>> ffcomp.estimate("print.gcode", "mp-delta-pro").time_s
    """
    path, flavor, offset = Path(request.file), request.flavor, request.offset_mm
    with opened_print(path, request.plate) as source:
        machine = load_machine(request.machine) if request.machine else _stamped(source, path)
        found = estimation.estimate(source, str(path), machine, flavor=flavor, offset=offset)
    return replace(found, lists_layers=request.layers)


def _stamped(source: Source, path: Path) -> Machine:
    """Return the machine that a compensated print names."""
    stamp = estimation.stamp_of(source)
    if stamp is None:
        raise RequestError(f"{path} does not name its machine: give --machine NAME (ffcomp machines list).")
    return machine_of(stamp, path)


estimate = function(EstimateRequest, estimate_request)
