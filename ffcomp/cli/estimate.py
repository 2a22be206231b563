"""`ffcomp estimate`: estimate how long a print takes, by layer and by feature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ffcomp.cli.command import Json, verb
from ffcomp.cli.common import answer, print_json
from ffcomp.errors import RequestError
from ffcomp.estimation.request import EstimateFilesRequest
from ffcomp.options import FIGURE
from ffcomp.request import OUTPUT, Option, Request
from ffcomp.result import Answer

if TYPE_CHECKING:
    from ffcomp.estimation.engine import Estimate
    from gcode.container import Source
    from models.machine import Machine


@dataclass(frozen=True, kw_only=True)
class EstimateShown(Request):
    """What is shown of an estimate."""

    layers: Annotated[bool, Option("Print a row for every layer.", OUTPUT)] = False
    figure: Annotated[Path | None, FIGURE] = None


@verb
def estimate(request: EstimateFilesRequest, details: EstimateShown, shown: Json) -> None:
    """Estimate how long a print takes, by layer and by feature.

    ffcomp plans the print as the firmware does and adds up the time. No file states how long heating, homing and
    macros take; they are listed, not guessed. A compensated print gets both times, as it is and as it was.

    Example: ffcomp estimate sample_prints/ringing_tower.gcode --machine mp-delta-pro
    """
    if details.figure is not None and len(request.files) > 1:
        raise RequestError("--figure is for one file.")
    found = [each for file in request.files for each in _estimates(file, request)]
    if details.figure is not None:
        from ffcomp.report.estimate import draw

        draw(found[0], details.figure)
    if shown.as_json and len(found) > 1:
        answers = [each.to_dict() for each in found]
        print_json(
            {
                "schema": "ffcomp-estimate-batch/1",
                "results": answers,  # [] ffcomp-estimate/1: in the order of the files
            }
        )
        return
    for each in found:
        answer(each, shown.as_json)
        if details.layers and not shown.as_json:
            print(*Answer(facts=each.layers).lines(), sep="\n")


def _estimates(file: Path, request: EstimateFilesRequest) -> Iterator[Estimate]:
    """Of each print that a file holds."""
    from ffcomp.estimation.engine import estimate
    from gcode.container import opened

    with opened(file) as container:
        for name, text in container.prints.items():
            path = f"{file}/{name}" if name else str(file)
            machine = _machine(text, path, request.machine)
            yield estimate(text, path, machine, flavor=request.flavor, offset=request.offset_mm)


def _machine(text: Source, path: str, name: str) -> Machine:
    """Load the machine asked for, or that of the print's stamp."""
    from ffcomp.cli.machine_files import machine_of
    from ffcomp.estimation.engine import stamp_of
    from models.file import load_machine

    if name:
        return load_machine(name)
    stamp = stamp_of(text)
    if stamp is None:
        raise RequestError(f"{path} does not say which machine it is for: --machine NAME (ffcomp machines list).")
    return machine_of(stamp, Path(path))
