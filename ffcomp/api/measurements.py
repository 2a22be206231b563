"""Measurements: the machine's parameters, the model discrepancy and its cause."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffcomp.diagnosis.gap import gap_request
from ffcomp.diagnosis.problems import paths_of, plant_of
from ffcomp.diagnosis.request import DiagnoseRequest, GapRequest
from ffcomp.diagnosis.verb import diagnose_request
from ffcomp.errors import RequestError, extras_told
from ffcomp.identification.fitting import fit_files
from ffcomp.identification.machine_fit import MachineFit
from ffcomp.identification.request import FitRequest, Method
from ffcomp.request import function
from models.machine import Machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Files = Sequence[str | Path] | str | Path
Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Identification:
    """A machine's parameters as measurements give them."""

    fit: MachineFit
    output: Path | None  # of the machine file; None: not written

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-identify-fit/1."""
        return self.fit.to_dict(None if self.output is None else str(self.output))

    @extras_told()
    def plot(self) -> Figure:
        """Draw the measured responses beside the fitted model.

        Raises
        ------
        RequestError
            If the data hold no responses.
        """
        from ffcomp.report.identify import figure_of

        figure = figure_of(self.fit)
        if figure is None:
            raise RequestError("These data hold no frequency responses to draw.")
        return figure


def identify(
    data: Files,
    machine: str | Path | Machine,
    output: str | Path | None = None,
    *,
    plan: str | Path | None = None,
    known: Mapping[str, tuple[float, float]] | None = None,
    method: Method = "direct",
    name: str = "",
    band_hz: tuple[float, float] = (2.0, 400.0),
    axes_map: Sequence[str] = ("x", "y", "z"),
    axis: str | Sequence[str] = (),
    column: str | None = None,
    rough: bool = False,
    progress: Progress = lambda sentence: None,
) -> Identification:
    """Fit a machine file's parameters to measurements, with their uncertainties.

    Parameters
    ----------
    data : frequency responses, recordings, captures of a plan, or a firmware's resonance tests
    machine : the machine to start from
    output : the machine file to write; None: write nothing
    plan : the file that `ffcomp record plan` wrote beside its G-code, for its captures
    known : value and standard deviation of parameters that are known, e.g. by a scale
    method : "direct", the output-error fit, or "stepwise", the paper's method
    name : of the new machine; "": the output file's
    band_hz : frequencies that are used
    axes_map : the printer's axes in the accelerometer's own
    axis : excited axis of resonance tests whose names do not state it: x, y, or a direction such as "1,-1"; one for
        all of them, or one each
    column : the spectrum to be used of files with several, where their header does not say what these are
    rough : write modes too that leave more than 20 % of their measurement unexplained

    Raises
    ------
    MeasurementError, MachineFileError, RequestError
    """
    start = plant_of(machine)
    request = FitRequest(
        data=tuple(paths_of(data)),
        machine=start.path,
        output=None if output is None else Path(output),
        plan=None if plan is None else Path(plan),
        known=known,
        method=method,
        name=name or None,
        lowest_hz=band_hz[0],
        highest_hz=band_hz[1],
        axes_map=",".join(axes_map),
        axis=(axis,) if isinstance(axis, str) else tuple(axis),
        column=column,
        rough=rough,
        force=True,
    )
    fit = fit_files(start, request, progress)
    if request.output is not None:
        fit.write(request.output)
    return Identification(fit, request.output)


gap = function(GapRequest, gap_request)
diagnose = function(DiagnoseRequest, diagnose_request)
