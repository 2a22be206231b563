"""`ffcomp frf`: compute frequency responses anywhere on the bed, and compare them with measured ones."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ffcomp.cli.command import verb
from ffcomp.cli.common import print_json, say
from ffcomp.identification.request import FrfRequest
from ffcomp.options import FIGURE
from ffcomp.request import OUTPUT, Option, Request

if TYPE_CHECKING:
    from ffcomp.identification.frf_study import Study
    from models.machine import Machine


@dataclass(frozen=True, kw_only=True)
class FrfFigures(Request):
    """What is drawn of frequency responses."""

    figure: Annotated[Path | None, FIGURE] = None
    full: Annotated[bool, Option("Draw all nine responses, not only the diagonal.", OUTPUT)] = False
    bed_map: Annotated[
        tuple[Path, ...],
        Option("Draw each mode over the bed: .png, .svg, .pdf; .json: its numbers.", OUTPUT, "--map", metavar="FILE"),
    ] = ()
    as_json: Annotated[bool, Option("Accepted; the output is JSON in any case.", OUTPUT, "--json")] = False


@verb
def frf(request: FrfRequest, figures: FrfFigures) -> None:
    """Compute the machine's frequency responses anywhere on the bed.

    Prints one JSON object (ffcomp-frf/1) for each position, and draws figures on request.

    Example: ffcomp frf -m mp-delta-pro --at 0,0 --at -80,0 --figure bode.png --map bed.png
    """
    from ffcomp.api.responses import study_responses
    from ffcomp.identification.frf_study import frf_json

    result = study_responses(request)
    for sentence in result.left_out:
        say(f"ffcomp: {sentence}")
    for station in result.stations:
        print_json(frf_json(result, station))
    _draw(result, figures)


def _draw(result: Study, figures: FrfFigures) -> None:
    if figures.figure is not None:
        from ffcomp.report.model import draw_bode

        draw_bode(result, figures.figure, figures.full)
        say(f"ffcomp: {figures.figure}")
    if figures.bed_map:
        _write_maps(result.machine, figures.bed_map)


def _write_maps(machine: Machine, targets: Sequence[Path]) -> None:
    from ffcomp.identification.frf_study import mode_map_json
    from gcode.atomic_write import replace_atomically
    from models.errors import MachineFileError
    from models.kinds import delta_vibration
    from models.vibration.mode_map import mode_map

    if not machine.vibration.position_dependent:
        rule = "Straight axes answer alike everywhere on the bed, so there is no map; --figure shows how."
        raise MachineFileError("--map", [rule])
    modes = mode_map(delta_vibration(machine))
    for target in targets:
        if target.suffix == ".json":
            replace_atomically(target, [json.dumps(mode_map_json(machine, modes)).encode()])
        else:
            from ffcomp.report.model import draw_map

            draw_map(machine, modes, target)
        say(f"ffcomp: {target}")
