"""`ffcomp frf`: compute frequency responses anywhere on the bed, and compare them with measured ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ffcomp.cli.command import verb
from ffcomp.cli.common import print_json, say
from ffcomp.identification.request import FrfRequest
from ffcomp.options import FIGURE
from ffcomp.request import OUTPUT, Option, Request


@dataclass(frozen=True, kw_only=True)
class FrfFigures(Request):
    """What is drawn of frequency responses."""

    figure: Annotated[Path | None, FIGURE] = None
    full: Annotated[bool, Option("Draw all nine responses, not only the diagonal.", OUTPUT)] = False
    as_json: Annotated[bool, Option("Accepted; the output is JSON in any case.", OUTPUT, "--json")] = False


@verb
def frf(request: FrfRequest, figures: FrfFigures) -> None:
    """Compute the machine's frequency responses anywhere on the bed.

    Prints one JSON object (ffcomp-frf/1) for each position, and draws figures on request.

    Example: ffcomp frf -m mp-delta-pro --at 0,0 --at -80,0 --figure bode.png
    """
    from ffcomp.api.responses import study_responses
    from ffcomp.identification.frf_study import frf_json

    result = study_responses(request)
    for sentence in result.left_out:
        say(f"ffcomp: {sentence}")
    for station in result.stations:
        print_json(frf_json(result, station))
    if figures.figure is not None:
        from ffcomp.report.model import draw_bode

        draw_bode(result, figures.figure, figures.full)
        say(f"ffcomp: {figures.figure}")
