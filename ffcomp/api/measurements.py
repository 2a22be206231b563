"""Measurements: the machine's parameters, the model discrepancy and its cause."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ffcomp.diagnosis.gap import gap_request
from ffcomp.diagnosis.problems import plant_of
from ffcomp.diagnosis.request import DiagnoseRequest, GapRequest
from ffcomp.diagnosis.verb import diagnose_request
from ffcomp.identification.fitting import fit_files
from ffcomp.identification.machine_fit import MachineFit
from ffcomp.identification.request import IdentifyRequest
from ffcomp.request import function


def _identify(request: IdentifyRequest) -> MachineFit:
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
    return fit if output is None else fit.write(output)


identify = function(IdentifyRequest, _identify)
gap = function(GapRequest, gap_request)
diagnose = function(DiagnoseRequest, diagnose_request)
