"""Compensate a print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffcomp.api.machines import load_machine
from ffcomp.compensation.batch import size_of, workers
from ffcomp.compensation.file import compensate_file
from ffcomp.compensation.job import Options
from ffcomp.compensation.request import CompensateRequest
from ffcomp.compensation.result import CompensatedFile
from ffcomp.errors import RequestError, missing_extras_explained
from ffcomp.integrations.slicer import Bed
from ffcomp.metrics import Track
from ffcomp.request import function
from gcode.container import read_bytes
from gcode.embedded import STAMP_REACH, already_processed, find_offset
from gcode.text import PART_BYTES
from models.machine import Machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Compensation:
    """A compensated print and what it took."""

    machine: Machine
    file: CompensatedFile  # what was done, print by print

    @property
    def output(self) -> Path | None:
        """The compensated file; None: nothing was written."""
        return None if self.file.output is None else Path(self.file.output)

    @property
    def print_time_s(self) -> float:
        """Print time of the compensated file in s."""
        return self.file.result.statistics.print_time_s

    @property
    def original_print_time_s(self) -> float:
        """Print time of the original in s."""
        return self.file.result.statistics.original_print_time_s

    @property
    def segments(self) -> int:
        """Number of segments written."""
        return self.file.result.statistics.segments

    @property
    def warnings(self) -> list[str]:
        """Sentences about what was odd or had to be changed."""
        return self.file.warnings

    @property
    def uncompensated(self) -> Track | None:
        """Predicted errors of the original; None: not predicted."""
        return self.file.result.predicted.get("uncompensated")

    @property
    def compensated(self) -> Track | None:
        """Predicted errors of the compensated print; None: not predicted."""
        return self.file.result.predicted.get("compensated")

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-compensate/1."""
        return self.file.to_dict()

    @missing_extras_explained()
    def plot(self, *, z_mm: float | None = None) -> Figure:
        """Draw the reference, the uncompensated and the compensated path.

        Parameters
        ----------
        z_mm : height of the layer; None: the layer that vibrates most

        Raises
        ------
        RequestError
            If no file was written.
        """
        from ffcomp.report.show import show_figure
        from ffcomp.simulation.preview import preview

        if self.output is None:
            raise RequestError("Nothing was written, so there is nothing to draw: name an output.")
        data = read_bytes(self.output, None)
        stamp = already_processed(data)
        flavor = stamp.flavor if stamp else None
        seen = preview(data, str(self.output), self.machine, find_offset(data[:STAMP_REACH]), flavor)
        return show_figure(seen, f"{self.output.name} on {self.machine.name}", z_mm=z_mm)


def compensate_print(
    request: CompensateRequest, name: str = "", advice: Sequence[str] = (), bed: Bed | None = None
) -> Compensation:
    """Compensate a print; one that is compensated already is left alone.

    Parameters
    ----------
    request : CompensateRequest
    name : the file, as messages call it; "": its path
    advice : warnings about how the file was made
    bed : the slicer's, if it has stated it otherwise than in the file
    """
    machine, file = load_machine(request.machine), Path(request.file)
    options = Options.of(request, machine, bed)
    target = None if request.output is None else Path(request.output)
    jobs = min(request.jobs, max(size_of(file) // PART_BYTES, 1))  # chunks
    with workers(jobs, request.scheduler) as at_once:
        done = compensate_file(
            file, name or str(file), machine, options, target, jobs=at_once, progress=request.progress
        )
    output = str(file) if done.already and done.output == done.path else done.output
    return Compensation(machine, replace(done, path=str(file), output=output, advice=tuple(advice)))


def _compensate(request: CompensateRequest) -> Compensation:
    """Compensate a print for a printer's vibration.

    Parameters
    ----------
    progress : Called with the share of the file that is done.

    Raises
    ------
    GcodeError, MachineFileError, LimitsError, SolverError, NothingToDo, RequestError
    """
    done = compensate_print(request)
    if done.file.already:
        raise RequestError(f"{done.file.already} With force=True it is compensated again.")
    return done


compensate = function(CompensateRequest, _compensate)
