"""Frequency responses of a machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ffcomp.api.machines import load_machine
from ffcomp.errors import RequestError, missing_extras_explained
from ffcomp.identification.frf_study import Bode, NumberedMode, Station, Study, View, bodes, study, verdict, view_of
from ffcomp.identification.request import FrfRequest
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.frf_files import read_frfs
from ffcomp.numerics.serialise import keys
from ffcomp.request import function
from ffcomp.result import Fact, Result
from models.arrays import ComplexArray, FloatArray
from models.errors import UnreachableError
from models.kinds import delta_vibration
from models.machine import Machine


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponses(Result):
    """Frequency responses of a machine at some positions: carriages A B C or nozzle axes X Y Z, as was requested."""

    title = "Frequency responses"
    schema = "ffcomp-frf/1"
    json_keys: ClassVar = keys("machine", "force_map", "position_mm", "frequency_hz", "verdict") | {
        "carriage": "carriages",
        "response.of": "study.view.of",
        "response.per": "per",
        "response.unit": "study.view.unit",
        "response.rows": "study.view.rows",
        "response.columns": "study.view.columns",
        "response.values": "requested",
        "added_mass_kg": "station.added_mass_kg",
        "modes": "station.modes",
        "measured": "station.compared",
    }
    drawn_by: ClassVar = {"bode": "ffcomp.report.model:figure_of"}

    machine: Machine
    frequency_hz: FloatArray  # (k,)
    positions_mm: FloatArray  # (n, 2), columns X Y
    values: ComplexArray  # (n, k, r, c): row r answers column c
    rows: tuple[str, ...]  # names of the outputs
    columns: tuple[str, ...]  # and of the inputs
    study: Study
    number: int = 0  # of the position that the JSON object is of

    @property
    def headline(self) -> str:
        """Where the machine resonates, or how well it agrees with the measurement."""
        return f"{self.machine.name}: {self.verdict}"

    @property
    def facts(self) -> list[Fact]:
        """The modes at each position."""
        return [(each.label, ", ".join(_mode(mode) for mode in each.modes)) for each in self.study.stations]

    @property
    def warnings(self) -> Sequence[str]:
        """Measured responses that are left out."""
        return self.study.left_out

    @property
    def station(self) -> Station:
        """The position that the JSON object is of."""
        return self.study.stations[self.number]

    @property
    def position_mm(self) -> tuple[float, float, float]:
        """Its place."""
        return (*self.station.xy.tolist(), 0.0)

    @property
    def force_map(self) -> str | None:
        """How a delta's forces are shared; None of other machines."""
        if not self.machine.vibration.position_dependent:
            return None
        return delta_vibration(self.machine).effector.force_map

    @property
    def per(self) -> str | None:
        """The input; None of a part by itself."""
        return self.study.view.per if self.study.view.depends_on_place else None

    @property
    def requested(self) -> list[list[Bode]]:
        """The requested responses there."""
        return bodes(self.station.value)

    @property
    def carriages(self) -> list[list[Bode]]:
        """Those of the carriages (Eq. 29) there."""
        return bodes(self.station.carriage)

    @property
    def verdict(self) -> str:
        """All of it in a sentence."""
        return verdict(self.study)

    def objects(self) -> list[dict[str, Any]]:
        """Return an object ffcomp-frf/1 for each position."""
        return [replace(self, number=number).to_dict() for number in range(len(self.study.stations))]

    @missing_extras_explained()
    def to_control(self) -> list[Any]:
        """Return each position's responses as a `control.FrequencyResponseData`, frequencies in rad/s."""
        import control

        omega = 2 * np.pi * self.frequency_hz
        return [control.frd(np.moveaxis(value, 0, -1), omega) for value in self.values]


def _mode(mode: NumberedMode) -> str:
    return f"{mode.frequency_hz:.1f} Hz (ζ {mode.damping_ratio:.3f}, {mode.kind})"


def _study(request: FrfRequest) -> Study:
    """Compute the responses of a request, and read the measured ones that they are compared with."""
    machine = load_machine(request.machine)
    measured = [response for path in request.measured for response in read_frfs(path)]
    view = _view(request, machine, measured)
    centre_x, centre_y = machine.kinematics.centre_mm
    positions = _places(request.positions_mm)
    if not len(positions) and not measured:
        positions = np.array([[centre_x, centre_y]])
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
    return study(machine, view, frequencies, list(positions), measured)


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

    Parameters
    ----------
    positions_mm : X, Y in mm, or an (n, 2) array of them; none: the middle of the bed
    frequency_hz : (k,) array, Hz; None: from the lowest to the highest in steps

    Raises
    ------
    MachineFileError, MeasurementError, RequestError

    Examples
    --------
    >>> ffcomp.frf("mp-delta-pro", (0, 0)).values.shape
    """
    result = _study(request)
    values = np.stack([station.value for station in result.stations])
    places = np.array([station.xy for station in result.stations])
    rows, columns = tuple(result.view.rows), tuple(result.view.columns)
    return FrequencyResponses(result.machine, result.frequency_hz, places, values, rows, columns, result)


frf = function(FrfRequest, frf_request)
