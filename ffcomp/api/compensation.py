"""Compensate a print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ffcomp.api.machines import load_machine
from ffcomp.compensation.batch import size_of, targets_of, workers
from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.request import CompensateRequest
from ffcomp.compensation.result import CompensatedFile
from ffcomp.errors import RequestError
from ffcomp.integrations.slicer import Bed
from ffcomp.request import function
from gcode.text import PART_BYTES


def compensate_print(
    request: CompensateRequest, target: Path | None, name: str = "", advice: Sequence[str] = (), bed: Bed | None = None
) -> CompensatedFile:
    """Compensate a single print; one that is compensated already is left alone.

    target : the file that is written; None: nothing is
    name : the file, as messages call it; "": its path
    advice : warnings about how the file was made
    bed : the slicer's, if it has stated it otherwise than in the file
    """
    machine, (file,) = load_machine(request.machine), request.paths
    jobs = min(request.jobs, max(size_of(file) // PART_BYTES, 1))  # chunks
    with workers(jobs, request.scheduler) as at_once:
        done = compensate_file(
            *(file, name or str(file), machine, request, target), bed=bed, jobs=at_once, progress=request.progress
        )
    output = file if done.already and str(done.output) == done.path else done.output
    return replace(done, path=str(file), output=output, advice=tuple(advice))


def _compensate(request: CompensateRequest) -> CompensatedFile:
    """Compensate a print for a printer's vibration.

    Raises
    ------
    GcodeError, MachineFileError, LimitsError, SolverError, NothingToDo, RequestError

    Examples
    --------
    >>> result = ffcomp.compensate("print.gcode", "mp-delta-pro", "out.gcode")
    >>> result.print_time_s, result.compensated.contour_rms_um
    """
    if len(request.paths) > 1:
        raise RequestError("files: compensate() takes a single print; call it for each.")
    done = compensate_print(request, *targets_of(request, in_place=False))
    if done.already:
        raise RequestError(f"{done.already} With force=True it is compensated again.")
    return done


compensate = function(CompensateRequest, _compensate)
