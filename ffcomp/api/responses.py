"""Frequency responses of a machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ffcomp.api.machines import load_machine
from ffcomp.errors import RequestError
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.frf_files import read_frfs
from ffcomp.request import function
from ffcomp.responses.request import FrfRequest
from ffcomp.responses.result import FrequencyResponses, frequency_responses
from ffcomp.responses.view import View, view_of
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.machine import Machine


def _places(positions_mm: Any) -> FloatArray:
    """Return positions as (n, 2) mm: of one X, Y or of several."""
    places = np.atleast_2d(_numbers("positions_mm", positions_mm))
    if places.size and (places.ndim != 2 or places.shape[1] != 2):
        raise RequestError(f"positions_mm has the shape {np.shape(positions_mm)}: it is X, Y in mm, or (n, 2).")
    return places.reshape(-1, 2)


def _numbers(name: str, values: Any) -> FloatArray:
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise RequestError(f"{name} = {values!r}: it holds numbers.") from None
    if not np.all(np.isfinite(numbers)):
        raise RequestError(f"{name}: every number must be finite.")
    return numbers


def _view(request: FrfRequest, machine: Machine, measured: Sequence[FrequencyResponse]) -> View:
    """Choose input and output: those of the request, else those of the first measurement, else what suits."""
    of, per = request.of, request.per
    if of is None and not machine.vibration.position_dependent:
        of = "nozzle"
    if of is None and per is None and measured:
        view = view_of(measured[0])
    else:
        output = of or "carriage"
        view = View(output, per or ("nozzle" if output in ("nozzle", "acceleration") else "carriage"))
    if per is not None and not view.depends_on_place:
        raise RequestError(f"--per {per}: --of {view.of} is no response of the whole printer.")
    return view


def frf_request(request: FrfRequest) -> FrequencyResponses:
    """Compute frequency responses of the linear model.

    Raises
    ------
    MachineFileError, MeasurementError, RequestError

    Examples
    --------
    >>> ffcomp.frf("mp-delta-pro", (0, 0)).values.shape
    """
    machine = load_machine(request.machine)
    measured = [response for path in request.measured for response in read_frfs(path)]
    view = _view(request, machine, measured)
    positions = _places(request.positions_mm)
    if not len(positions) and not measured:
        positions = np.array([machine.kinematics.centre_mm])
    for x, y in positions:
        try:
            machine.kinematics.check_reach(np.array([[x, y, 0.0]]))
        except UnreachableError as error:
            raise RequestError(f"--at {x:g},{y:g}: {error}") from None
    frequencies = np.arange(request.start_hz, request.highest_hz + 0.5 * request.step_hz, request.step_hz)
    if request.frequency_hz is not None:
        frequencies = np.atleast_1d(_numbers("frequency_hz", request.frequency_hz))
        if frequencies.ndim != 1 or not frequencies.size or frequencies.min() <= 0.0:
            raise RequestError("frequency_hz is a list of frequencies above 0 Hz, (k,).")
    return frequency_responses(machine, view, frequencies, list(positions), measured)


frf = function(FrfRequest, frf_request)
