"""Estimate how long a print takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffcomp.api.machines import load_machine
from ffcomp.errors import missing_extras_explained
from ffcomp.estimation import engine as estimation
from ffcomp.estimation.request import EstimateRequest
from ffcomp.estimation.statistics import Statistics
from ffcomp.request import function
from gcode.container import opened

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class PrintTime:
    """Times of a print, as it is written and, of a compensated one, as it was."""

    estimate: estimation.Estimate

    @property
    def time_s(self) -> float:
        """Print time in s, without heating, homing and macros."""
        return self.estimate.time_s

    @property
    def statistics(self) -> Statistics:
        """Times by layer, feature and activity."""
        return self.estimate.statistics

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-estimate/1."""
        return self.estimate.to_dict()

    @missing_extras_explained()
    def plot(self) -> Figure:
        """Draw the time by layer and by feature."""
        from ffcomp.report.estimate import estimate_figure

        return estimate_figure(self.estimate)


def _estimate(request: EstimateRequest) -> PrintTime:
    """Estimate how long a print takes.

    Raises
    ------
    GcodeError, MachineFileError, NothingToDo
    """
    with opened(Path(request.file)) as container:
        source, machine = next(iter(container.prints.values())), load_machine(request.machine)
        options: dict[str, Any] = {"flavor": request.flavor, "offset": request.offset_mm}
        return PrintTime(estimation.estimate(source, str(request.file), machine, **options))


estimate = function(EstimateRequest, _estimate)
