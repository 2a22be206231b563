"""`ffcomp estimate`: estimate how long a print takes, by layer and by feature."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from ffcomp.cli.command import verb
from ffcomp.cli.common import machine_of
from ffcomp.errors import RequestError
from ffcomp.estimation.request import EstimateFilesRequest
from ffcomp.numerics.serialise import keys
from ffcomp.result import Fact, Result, clock

if TYPE_CHECKING:
    from ffcomp.estimation.engine import Estimate
    from gcode.container import Source
    from models.machine import Machine


@verb
def estimate(request: EstimateFilesRequest) -> Result:
    """Estimate how long a print takes, by layer and by feature.

    ffcomp plans the print as the firmware does and adds up the time. Heating, homing and macros are listed but not
    included, because no file contains their duration. A compensated print gets a time with and without compensation.

    Example: ffcomp estimate sample_prints/ringing_tower.gcode --machine mp-delta-pro
    """
    found = [replace(each, lists_layers=request.layers) for file in request.files for each in _estimates(file, request)]
    return found[0] if len(found) == 1 else Estimates(found)


@dataclass(frozen=True, eq=False, repr=False)
class Estimates(Result):
    """Several prints."""

    schema = "ffcomp-estimate-batch/1"
    json_keys: ClassVar = keys("results")

    results: Sequence[Estimate]

    @property
    def headline(self) -> str:
        """How long they take together."""
        return f"{len(self.results)} prints take {clock(sum(each.time_s for each in self.results))}."

    @property
    def facts(self) -> list[Fact]:
        """Each of them."""
        return [fact for each in self.results for fact in ((each.path, each.headline), *each.facts)]

    @property
    def warnings(self) -> list[str]:
        """Of each of them."""
        return [f"{each.path}: {warning}" for each in self.results for warning in each.warnings]


def _estimates(file: Path, request: EstimateFilesRequest) -> Iterator[Estimate]:
    """Estimate each print in a file."""
    from ffcomp.estimation.engine import estimate
    from gcode.container import opened

    with opened(file) as container:
        for name, text in container.prints.items():
            path = f"{file}/{name}" if name else str(file)
            machine = _machine(text, path, request.machine)
            yield estimate(text, path, machine, flavor=request.flavor, offset=request.offset_mm)


def _machine(text: Source, path: str, name: str) -> Machine:
    """Load the named machine, or that of the print's stamp."""
    from ffcomp.estimation.engine import stamp_of
    from models.file import load_machine

    if name:
        return load_machine(name)
    stamp = stamp_of(text)
    if stamp is None:
        raise RequestError(f"{path} does not name its machine: give --machine NAME (ffcomp machines list).")
    return machine_of(stamp, Path(path))
