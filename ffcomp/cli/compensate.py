"""`ffcomp compensate`: the main job, by hand or as a slicer's post-processing script."""

from __future__ import annotations

import os
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ffcomp.cli.command import verb
from ffcomp.cli.common import fail, say
from ffcomp.cli.progress import Progress
from ffcomp.compensation.request import CompensateRequest
from ffcomp.result import Result

if TYPE_CHECKING:
    from ffcomp.compensation.result import CompensatedFile, CompensatedFiles
    from ffcomp.integrations.slicer import Call
    from models.machine import Machine


@verb
def compensate(request: CompensateRequest) -> Result:
    """Compensate a print for your printer's vibration.

    ffcomp plans the print as the firmware does, computes the carriage paths and inverts the machine's vibration model
    along them. Lines that are not moves pass through byte for byte.

    As a slicer's post-processing script, use the full path of ffcomp followed by: compensate --machine NAME. The
    slicer adds the file. See: ffcomp integrations. Every run is logged: ffcomp --log-path.

    Example: ffcomp compensate sample_prints/ringing_tower.gcode --machine mp-delta-pro -o out.gcode
    """
    from ffcomp.compensation.batch import targets_of
    from ffcomp.integrations.slicer import read_call
    from models.file import load_machine

    targets = targets_of(request, in_place=True)
    machine, call = load_machine(str(request.machine)), read_call(os.environ)
    advice = _advice(request, machine, call)
    if len(targets) == 1:
        return _compensate_one(replace(request, machine=machine), targets[0], call, advice)
    for sentence in advice:
        say(f"ffcomp: {sentence}")
    return _compensate_all(request, machine, targets, call)


def _advice(request: CompensateRequest, machine: Machine, call: Call) -> list[str]:
    """Collect warnings about the slicer's settings, and about an offset that does not suit its bed."""
    from ffcomp.integrations.slicer import bed_of, bed_warning, call_warnings

    files, offset = request.paths, request.offset_mm
    warnings = call_warnings(call)
    bed = call.bed or (bed_of(files[0]) if len(files) == 1 else None)  # several may be for several beds
    return warnings if bed is None or offset is None else warnings + bed_warning(bed, machine, offset)


def _compensate_one(request: CompensateRequest, target: Path | None, call: Call, advice: list[str]) -> CompensatedFile:
    """Compensate a single file. The user never sees the name of a slicer's temporary file, but that of the output."""
    from ffcomp.api.compensation import compensate_print

    with Progress(1.0) as progress:
        now = replace(request, progress=progress)
        done = compensate_print(now, target, call.output_name, advice, call.bed)
    if call.host and done.output == request.paths[0]:
        return replace(done, seen_at=call.output_name if call.host == "File" else "")
    return done


def _compensate_all(
    request: CompensateRequest, machine: Machine, targets: list[Path] | list[None], call: Call
) -> CompensatedFiles:
    """Compensate several files; return their results in the order of the files."""
    from ffcomp.compensation.batch import compensate_files, size_of
    from ffcomp.compensation.result import CompensatedFiles, FileResult
    from ffcomp.errors import interrupts_restored
    from gcode.atomic_write import drafts_noted, replaced_since

    files, noted = request.paths, drafts_noted()
    results: list[FileResult] = []
    with Progress(sum(map(size_of, files))) as progress:
        work = compensate_files(files, targets, machine, request, bed=call.bed, progress=progress)
        try:
            with interrupts_restored(), closing(work):
                results.extend(work)
        except KeyboardInterrupt:
            done = len(replaced_since(noted))
            fail(f"Interrupted; {done} of {len(files)} files are done, the others are unchanged.", 130)
    return CompensatedFiles(sorted(results, key=lambda each: each.number))
