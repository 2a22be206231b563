"""Estimate how long a print takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ffcomp.api.machines import load_machine, machine_of
from ffcomp.errors import RequestError
from ffcomp.estimation import engine as estimation
from ffcomp.estimation.request import EstimateRequest
from ffcomp.request import function
from gcode.container import ends_of, opened_print
from gcode.embedded import find_stamp


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
        stamp = None if request.machine else find_stamp(*ends_of(source)[:2])
        if stamp is None and not request.machine:
            raise RequestError(f"{path} does not name its machine: give --machine NAME (ffcomp machines list).")
        machine = load_machine(request.machine) if stamp is None else machine_of(stamp, path)
        found = estimation.estimate(source, str(path), machine, flavor=flavor, offset=offset)
    return replace(found, lists_layers=request.layers)


estimate = function(EstimateRequest, estimate_request)
