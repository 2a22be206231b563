"""Compare all methods on a print."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ffcomp.api.machines import load_machine
from ffcomp.comparison import engine
from ffcomp.comparison.request import CompareRequest
from ffcomp.comparison.result import Comparison
from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.compensation.placement import place_print
from ffcomp.inverse.settings import settings_for
from ffcomp.request import function
from ffcomp.simulation.playback import check_same_kinematics
from gcode.container import read_bytes
from gcode.embedded import STAMP_REACH, already_processed, find_offset, original


def compare_request(request: CompareRequest) -> Comparison:
    """Compare ffcomp with every input shaper on a print.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo, RequestError

    Examples
    --------
    >>> ffcomp.compare("print.gcode", "mp-delta-pro", only=["mzv"]).headline
    """
    engine.names(request.only)
    machine, notes = load_machine(request.machine), list[str]()
    plant = load_machine(request.plant or machine)
    check_same_kinematics(machine, plant)
    data, offset = read_bytes(Path(request.file), request.plate), request.offset_mm
    if already_processed(data) is not None:
        notes.append(f"{request.file} is already compensated: the comparison uses the original that it contains.")
        offset = find_offset(data[:STAMP_REACH]) if offset is None else offset
        data = original(data)
    if offset is None:
        placed = place_print(data, str(request.file), machine, request.flavor)
        offset = placed.offset
        if placed.notable:
            notes.append(placed.reason)
    done = engine.compare(
        Print(data, str(request.file), machine, offset, request.flavor),
        plant,
        sampling=Sampling(*request.layers, request.sample),
        quality_um=request.quality_um,
        only=request.only,
        settings=settings_for(machine, request.max_segments_per_second),
        progress=request.progress,
    )
    return replace(done, notes=tuple(notes))


compare = function(CompareRequest, compare_request)
