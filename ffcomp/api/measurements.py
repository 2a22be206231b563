"""Measurements: the machine's parameters, the model discrepancy and its cause."""

from __future__ import annotations

from ffcomp.diagnosis.problems import plant_of
from ffcomp.diagnosis.request import DiagnoseRequest, GapRequest
from ffcomp.diagnosis.verb import diagnose_request, gap_request
from ffcomp.identification.fitting import fit_files
from ffcomp.identification.machine_fit import MachineFit
from ffcomp.identification.request import IdentifyRequest
from ffcomp.request import function


def _identify(request: IdentifyRequest) -> MachineFit:
    """Fit a machine file's parameters to measurements, with their uncertainties.

    Raises
    ------
    MeasurementError, MachineFileError, RequestError

    Examples
    --------
    >>> ffcomp.identify(["carriage.csv"], "mp-delta-pro", "my.toml")
    """
    fit = fit_files(plant_of(request.machine), request, request.progress)
    return fit if request.output is None else fit.write(request.output)


identify = function(IdentifyRequest, _identify)
gap = function(GapRequest, gap_request)
diagnose = function(DiagnoseRequest, diagnose_request)
