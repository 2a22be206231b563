"""Estimate how long a print takes."""

from __future__ import annotations

from pathlib import Path

from ffcomp.api.machines import load_machine
from ffcomp.estimation import engine as estimation
from ffcomp.estimation.request import EstimateRequest
from ffcomp.request import function
from gcode.container import opened


def _estimate(request: EstimateRequest) -> estimation.Estimate:
    """Estimate how long a print takes.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo

    Examples
    --------
    >>> ffcomp.estimate("print.gcode", "mp-delta-pro").time_s
    """
    with opened(Path(request.file)) as container:
        source, machine = next(iter(container.prints.values())), load_machine(request.machine)
        path, offset = str(request.file), request.offset_mm
        return estimation.estimate(source, path, machine, flavor=request.flavor, offset=offset)


estimate = function(EstimateRequest, _estimate)
