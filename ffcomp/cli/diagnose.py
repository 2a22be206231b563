"""`ffcomp diagnose`: find the physical effect that a machine file lacks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from ffcomp.cli.command import verb
from ffcomp.cli.common import report
from ffcomp.diagnosis.request import DiagnoseRequest
from ffcomp.request import FORCE, Request
from ffcomp.result import Result


@dataclass(frozen=True, kw_only=True)
class Writing(Request):
    """Whether files are overwritten; only the command line asks."""

    force: Annotated[bool, FORCE] = False


@verb
def diagnose(request: DiagnoseRequest, writing: Writing) -> Result:
    """Find the physical effect that the machine file lacks, and its size.

    The answer is one effect or several, none, or unknown. A change of the file's own parameters within their
    uncertainty is retuning, not an effect. An effect is named only if it explains the discrepancy at positions it was
    not fitted to. The answer ends with what to do to the printer.

    Captures of ffcomp record plan are joined with their commands by --plan.

    Example: ffcomp diagnose runs/*.csv --machine my-delta.toml -o better.toml --report diagnosis.html
    """
    from ffcomp.cli.progress import SearchProgress
    from ffcomp.diagnosis.diagnosis import USUAL_S
    from ffcomp.diagnosis.verb import diagnose_request

    request = replace(request, progress=report)
    with SearchProgress(USUAL_S) as search_progress:
        return diagnose_request(request, search_progress)
