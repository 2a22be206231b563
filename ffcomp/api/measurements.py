"""Measurements: the machine's parameters, the model discrepancy and its cause."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffcomp.diagnosis.gap import gap_request
from ffcomp.diagnosis.problems import plant_of
from ffcomp.diagnosis.request import DiagnoseRequest, GapRequest
from ffcomp.diagnosis.verb import diagnose_request
from ffcomp.errors import RequestError, missing_extras_explained
from ffcomp.identification.fitting import fit_files
from ffcomp.identification.machine_fit import MachineFit
from ffcomp.identification.request import IdentifyRequest
from ffcomp.request import function

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """A machine's parameters as measurements give them."""

    fit: MachineFit
    output: Path | None  # of the machine file; None: not written

    def __repr__(self) -> str:
        """Return the machine, the method and the file."""
        return f"<Identification: {self.fit.name}, {self.fit.method}, {self.output or 'not written'}>"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-identify-fit/1."""
        return self.fit.to_dict(None if self.output is None else str(self.output))

    @missing_extras_explained()
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


def _identify(request: IdentifyRequest) -> Identification:
    """Fit a machine file's parameters to measurements, with their uncertainties.

    Parameters
    ----------
    progress : takes sentences on what is being done

    Raises
    ------
    MeasurementError, MachineFileError, RequestError

    Examples
    --------
    >>> ffcomp.identify(["carriage.csv"], "mp-delta-pro", "my.toml")
    """
    output, plan = (None if each is None else Path(each) for each in (request.output, request.plan))
    request = replace(request, output=output, plan=plan)
    fit = fit_files(plant_of(request.machine), request, request.progress)
    if output is not None:
        fit.write(output)
    return Identification(fit, output)


identify = function(IdentifyRequest, _identify)
gap = function(GapRequest, gap_request)
diagnose = function(DiagnoseRequest, diagnose_request)
