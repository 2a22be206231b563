"""`ffcomp frf`: compute frequency responses anywhere on the bed, and compare them with measured ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ffcomp.cli.command import verb
from ffcomp.options import FIGURE
from ffcomp.request import Request
from ffcomp.responses.request import FrfRequest
from ffcomp.result import Result


@dataclass(frozen=True, kw_only=True)
class FrfFigures(Request):
    """Picture of frequency responses."""

    figure: Annotated[Path | None, FIGURE] = None


@verb
def frf(request: FrfRequest, figures: FrfFigures) -> Result:
    """Compute the machine's frequency responses anywhere on the bed.

    With --json it prints an object (ffcomp-frf/1) for each position, with the responses' values.

    Example: ffcomp frf -m mp-delta-pro --at 0,0 --at -80,0 --figure bode.png
    """
    from ffcomp.api.responses import frf_request

    return frf_request(request)
