"""`ffcomp gap`: measure where and how much recordings and simulation disagree."""

from __future__ import annotations

from dataclasses import replace

from ffcomp.cli.command import verb
from ffcomp.cli.common import report
from ffcomp.diagnosis.request import GapRequest
from ffcomp.result import Result


@verb
def gap(request: GapRequest) -> Result:
    """Measure where and how much recordings and simulation disagree.

    ffcomp simulates each recording with the machine file and its effects. Repeats give the noise: files whose names
    differ in a trailing -1, -2, … only. Captures of ffcomp record plan are joined with their commands by --plan.

    Example: ffcomp gap runs/*.csv --machine my-delta.toml
    """
    from ffcomp.diagnosis.verb import gap_request

    return gap_request(replace(request, progress=report))
