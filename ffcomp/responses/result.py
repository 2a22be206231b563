"""The model's frequency responses at chosen positions, with the measured ones, for tables and figures.

A *station* is one case of a view: a position on the bed, or a mass on the bare carriage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ffcomp.errors import MeasurementError, missing_extras_explained
from ffcomp.identification.predict import log_error_db, mean_absolute_percentage_accuracy, predicted
from ffcomp.measurement.frf import CARRIAGES_AS_AXES, FrequencyResponse
from ffcomp.numerics.serialise import keys
from ffcomp.responses.modes import NumberedMode, carriage_modes, effector_modes, modes_at
from ffcomp.responses.view import Pair, View
from ffcomp.result import Fact, Result
from models.arrays import ComplexArray, FloatArray
from models.errors import MachineFileError, UnreachableError
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.substructures import command_frf, with_added_mass

SAME_PLACE_MM = 0.5  # a measurement this close to a place was made there
CLOSE, FAIR = 90.0, 70.0  # %; the paper reaches 68-78 in magnitude and 80-84 in phase (Table II)


@dataclass(frozen=True, eq=False)
class Bode:
    """A frequency response as people draw it."""

    magnitude: FloatArray  # (k,)
    phase_deg: FloatArray  # (k,) unwrapped


@dataclass(frozen=True, eq=False)
class Compared:
    """One measured response and the model's own, both as the view has them."""

    json_keys: ClassVar = keys("lines", "band_hz", "log_error_db") | keys(
        source="response.source",
        input="response.input",
        output="response.output",
        magnitude_accuracy_percent="magnitude_percent",
        phase_accuracy_percent="phase_percent",
    )

    response: FrequencyResponse
    pair: Pair  # row and column of the view
    frequency_hz: FloatArray  # (k,)
    measured: ComplexArray  # (k,)
    predicted: ComplexArray  # (k,)
    magnitude_percent: float  # μ_acc
    phase_percent: float
    log_error_db: float

    @property
    def lines(self) -> int:
        """How many frequencies are compared."""
        return len(self.frequency_hz)

    @property
    def band_hz(self) -> tuple[float, float]:
        """The first and the last of them."""
        return float(self.frequency_hz[0]), float(self.frequency_hz[-1])


@dataclass(frozen=True, eq=False)
class Station:
    """The model at one case of a view, with the measurements there."""

    label: str
    xy: FloatArray  # (2,) mm
    added_mass_kg: float
    value: ComplexArray  # (k, rows, columns)
    carriage: ComplexArray  # (k, 3, 3) G of Eq. 29, whatever the view
    modes: tuple[NumberedMode, ...]
    compared: tuple[Compared, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponses(Result):
    """Frequency responses of a machine at some positions: carriages A B C or nozzle axes X Y Z, as was requested."""

    title = "Frequency responses"
    schema = "ffcomp-frf/1"
    json_keys: ClassVar = keys("machine", "force_map", "position_mm", "frequency_hz", "verdict") | {
        "carriage": "carriages",
        "response.of": "view.of",
        "response.per": "per",
        "response.unit": "view.unit",
        "response.rows": "rows",
        "response.columns": "columns",
        "response.values": "requested",
        "added_mass_kg": "station.added_mass_kg",
        "modes": "station.modes",
        "measured": "station.compared",
    }
    drawn_by: ClassVar = {"bode": "ffcomp.report.model:bode_figure"}

    machine: Machine
    view: View
    frequency_hz: FloatArray  # (k,)
    stations: tuple[Station, ...]
    left_out: tuple[str, ...]  # sentences: measured responses that are not of this view
    number: int = 0  # of the station that the JSON object is of

    @property
    def positions_mm(self) -> FloatArray:
        """(n, 2), columns X Y."""
        return np.array([station.xy for station in self.stations])

    @property
    def values(self) -> ComplexArray:
        """(n, k, r, c): row r answers column c."""
        return np.stack([station.value for station in self.stations])

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.view.rows

    @property
    def columns(self) -> tuple[str, ...]:
        """And of the inputs."""
        return self.view.columns

    @property
    def headline(self) -> str:
        """Where the machine resonates, or how well it agrees with the measurement."""
        return f"{self.machine.name}: {self.verdict}"

    @property
    def facts(self) -> list[Fact]:
        """The modes at each position."""
        return [
            (each.label, ", ".join(f"{m.frequency_hz:.1f} Hz (ζ {m.damping_ratio:.3f}, {m.kind})" for m in each.modes))
            for each in self.stations
        ]

    @property
    def warnings(self) -> Sequence[str]:
        """Measured responses that are left out."""
        return self.left_out

    @property
    def station(self) -> Station:
        """The station that the JSON object is of."""
        return self.stations[self.number]

    @property
    def position_mm(self) -> tuple[float, float, float]:
        """Its place."""
        return (*self.station.xy.tolist(), 0.0)

    @property
    def force_map(self) -> str | None:
        """How a delta's forces are shared; None of other machines."""
        return delta_vibration(self.machine).effector.force_map if _is_delta(self.machine) else None

    @property
    def per(self) -> str | None:
        """The input; None of a part by itself."""
        return self.view.per if self.view.depends_on_place else None

    @property
    def requested(self) -> list[list[Bode]]:
        """The requested responses there, as rows of columns."""
        return _bodes(self.station.value)

    @property
    def carriages(self) -> list[list[Bode]]:
        """Those of the carriages (Eq. 29) there."""
        return _bodes(self.station.carriage)

    @property
    def verdict(self) -> str:
        """All of it in a sentence."""
        compared = [each for station in self.stations for each in station.compared]
        return _measured_verdict(compared) if compared else self._model_verdict

    @property
    def _model_verdict(self) -> str:
        ringing = [mode.frequency_hz for station in self.stations for mode in station.modes if mode.rings]
        if not ringing:
            return "Nothing rings: every mode is damped by more than 30 %."
        slow, fast = min(ringing), max(ringing)
        rings = f"Rings at {slow:.0f} Hz" if fast - slow < 0.5 else f"Rings between {slow:.0f} and {fast:.0f} Hz"
        if self.view.unit != "mm/mm":
            return f"{rings}."
        loudest = [
            (np.abs(s.value[:, *pair]), self.rows[pair[0]], s) for s in self.stations for pair in self.view.pairs
        ]
        magnitude, name, where = max(loudest, key=lambda each: float(each[0].max()))
        hz = self.frequency_hz[int(np.argmax(magnitude))]
        return (
            f"{rings}; at worst {name} answers {magnitude.max():.1f} times its command, at {hz:.0f} Hz, {where.label}."
        )

    def objects(self) -> list[dict[str, Any]]:
        """Return an object ffcomp-frf/1 for each position."""
        return [replace(self, number=number).to_dict() for number in range(len(self.stations))]

    @missing_extras_explained()
    def to_control(self) -> list[Any]:
        """Return each position's responses as a `control.FrequencyResponseData`, frequencies in rad/s."""
        import control

        omega = 2 * np.pi * self.frequency_hz
        return [control.frd(np.moveaxis(value, 0, -1), omega) for value in self.values]


def frequency_responses(
    machine: Machine,
    view: View,
    frequency_hz: FloatArray,
    places: Sequence[FloatArray],
    measured: Sequence[FrequencyResponse] = (),
) -> FrequencyResponses:
    """Evaluate a view at places, (2,) mm each, and where, or with what mass, responses of it were measured.

    Raises MachineFileError for a view of carriages, of straight axes; MeasurementError for a response that was measured
    beyond the machine's reach.
    """
    if not _is_delta(machine):
        if "carriage" in (view.answering, view.per):
            raise MachineFileError(
                f"--of {view.of}",
                ["This machine's axes are described by modes, not by carriages and an effector: look at --of nozzle."],
            )
        centre = machine.kinematics.centre_mm
        places, measured = [np.array(centre)], [_of_axes(response, centre) for response in measured]
    paired = [(response, view.pair(response)) for response in measured]
    fitting = [(response, pair) for response, pair in paired if pair is not None]
    for response, _ in fitting:
        try:
            machine.kinematics.check_reach(np.array([[*_place(response), 0.0]]))
        except UnreachableError as error:
            raise MeasurementError(response.source, [f"{response.input} to {response.output}: {error}"]) from None
    stations = []
    for xy, mass in _cases(view, places, [response for response, _ in fitting]):
        here = [(r, pair) for r, pair in fitting if _belongs(view, r, xy, mass)]
        compared = tuple(_compare(machine, view, response, pair) for response, pair in here)
        label, value, modes = _evaluated(machine, view, frequency_hz, xy, mass)
        carriage = machine.vibration.frequency_response(xy, frequency_hz)
        stations.append(Station(label, xy, mass, value, carriage, modes, compared))
    left_out = tuple(view.left_out(response) for response, pair in paired if pair is None)
    return FrequencyResponses(machine, view, frequency_hz, tuple(stations), left_out)


def _is_delta(machine: Machine) -> bool:
    return machine.vibration.position_dependent


def _of_axes(response: FrequencyResponse, centre_mm: tuple[float, float]) -> FrequencyResponse:
    """Rename the carriages of straight axes to the axes, A to x; every place counts as the centre."""
    commanded, answers = (name.translate(CARRIAGES_AS_AXES) for name in (response.input, response.output))
    return replace(response, input=commanded, output=answers, position_mm=(*centre_mm, 0.0))


def _cases(
    view: View, places: Sequence[FloatArray], measured: Sequence[FrequencyResponse]
) -> list[tuple[FloatArray, float]]:
    """List (position, added mass), without repeats."""
    if not view.depends_on_place:
        return [(np.zeros(2), mass) for mass in sorted({round(r.added_mass_kg, 6) for r in measured} or {0.0})]
    distinct: list[FloatArray] = []
    for place in [*places, *map(_place, measured)] or [np.zeros(2)]:
        if not any(np.abs(place - other).max() <= SAME_PLACE_MM for other in distinct):
            distinct.append(place)
    return [(place, 0.0) for place in distinct]


def _place(response: FrequencyResponse) -> FloatArray:
    return np.array((response.position_mm or (0.0, 0.0))[:2])


def _belongs(view: View, response: FrequencyResponse, xy: FloatArray, mass: float) -> bool:
    if view.depends_on_place:
        return bool(np.abs(_place(response) - xy).max() <= SAME_PLACE_MM)
    return abs(response.added_mass_kg - mass) < 1e-6


def _evaluated(
    machine: Machine, view: View, frequency_hz: FloatArray, xy: FloatArray, mass: float
) -> tuple[str, ComplexArray, tuple[NumberedMode, ...]]:
    """Return a station's label, its response (k, rows, columns) and its modes."""
    s = np.asarray(2j * np.pi * frequency_hz, dtype=np.complex128)
    if view.of == "carriage-alone":
        value = command_frf(with_added_mass(delta_vibration(machine).carriage, mass), s)[:, None, None]
        label = f"with {1e3 * mass:g} g more" if mass else "without added mass"
        return label, value, carriage_modes(machine, mass)
    if view.of == "effector-alone":
        return "by itself", delta_vibration(machine).struck_frf(s)[:, :, None] * np.eye(3), effector_modes(machine)
    value = machine.vibration.frequency_response(xy, frequency_hz, view.answering, view.per)
    label = f"at ({xy[0]:g}, {xy[1]:g}) mm" if _is_delta(machine) else "anywhere"
    return label, value, modes_at(machine, xy)


def _compare(machine: Machine, view: View, response: FrequencyResponse, pair: Pair) -> Compared:
    """Compare in the view's unit: an acceleration per position becomes the position, or the other way round."""
    there = np.abs(response.value) > 0  # a line of nothing has no relative error
    is_acceleration = response.output.startswith("acc_")
    factor = response.s[there] ** (2.0 * ((view.of in ("acceleration", "effector-alone")) - is_acceleration))
    measured, ours = response.value[there] * factor, predicted(machine, [response])[0][there] * factor
    magnitude, phase = mean_absolute_percentage_accuracy(measured, ours)
    decibel = log_error_db(measured, ours)
    return Compared(response, pair, response.frequency_hz[there], measured, ours, magnitude, phase, decibel)


def _measured_verdict(compared: Sequence[Compared]) -> str:
    magnitude = float(np.mean([each.magnitude_percent for each in compared]))
    phase = float(np.mean([each.phase_percent for each in compared]))
    decibel = float(np.sqrt(np.mean([each.log_error_db**2 for each in compared])))
    worst = min(magnitude, phase)
    grade = "close" if worst > CLOSE else "fair" if worst > FAIR else "poor: identify the machine again"
    what = "the measured response" if len(compared) == 1 else f"the {len(compared)} measured responses"
    return (
        f"Model against {what}: {magnitude:.0f} % accurate in magnitude, {phase:.0f} % in phase "
        f"({decibel:.1f} dB off): {grade}."
    )


def _bodes(g: ComplexArray) -> list[list[Bode]]:
    """Return responses (k, r, c) as rows of columns."""
    phase = np.degrees(np.unwrap(np.angle(g), axis=0))
    return [[Bode(np.abs(g[:, i, k]), phase[:, i, k]) for k in range(g.shape[2])] for i in range(g.shape[1])]
