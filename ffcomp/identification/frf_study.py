"""The model's frequency responses at chosen positions, with the measured ones, as data for tables and figures.

A *view* selects the responses: of the whole printer (output per command), of a carriage by itself (sub-model 1) or of
the effector by itself (sub-model 2). A *station* is one case of it: a position on the bed, or a mass on the bare
carriage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identification.predict import log_error_db, mean_absolute_percentage_accuracy, predicted
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.numerics.serialise import keys
from models.arrays import ComplexArray, FloatArray
from models.errors import MachineFileError, UnreachableError
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.base import Modes, Output
from models.vibration.mode_map import kinds, numbers
from models.vibration.substructures import command_frf, damping, with_added_mass

Of = Literal["carriage", "nozzle", "acceleration", "carriage-alone", "effector-alone"]
Per = Literal["carriage", "nozzle"]

Pair = tuple[int, int]
CARRIAGES, AXES = ("A", "B", "C"), ("x", "y", "z")
SAME_PLACE_MM = 0.5  # a measurement this close to a place was made there
RINGS = 0.3  # modes damped more than this make no peak
CLOSE, FAIR = 90.0, 70.0  # %; the paper reaches 68-78 in magnitude and 80-84 in phase (Table II)


@dataclass(frozen=True)
class View:
    """Which responses: the output `of` the printer or a part, `per` command."""

    of: Of = "carriage"
    per: Per = "carriage"

    @property
    def depends_on_place(self) -> bool:
        """Whether the response differs over the bed."""
        return self.of in ("carriage", "nozzle", "acceleration")

    @property
    def answering(self) -> Output:
        """The output of the whole printer; of a sub-model the carriages."""
        return self.of if self.of in ("nozzle", "acceleration") else "carriage"

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return {"carriage": CARRIAGES, "carriage-alone": ("carriage",)}.get(self.of, AXES)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the inputs, commanded or struck."""
        if not self.depends_on_place:
            return self.rows
        return CARRIAGES if self.per == "carriage" else AXES

    @property
    def unit(self) -> str:
        """Unit of the response."""
        return {"acceleration": "1/s²", "effector-alone": "1/kg"}.get(self.of, "mm/mm")

    @property
    def title(self) -> str:
        """Heading for figures and tables."""
        alone = {
            "carriage-alone": "One carriage on its belt, effector off: command to position",
            "effector-alone": "The effector by itself: force on the nozzle holder to its acceleration",
        }
        answers = {"carriage": "carriage position", "nozzle": "nozzle position", "acceleration": "nozzle acceleration"}
        return alone.get(self.of) or f"Commanded {self.per} to {answers[self.of]}"

    @property
    def pairs(self) -> list[Pair]:
        """(row, column) shown by default: the response of each output to its own input."""
        if self.rows == self.columns:
            return [(i, i) for i in range(len(self.rows))]
        return [(i, k) for i in range(3) for k in range(3)]


@dataclass(frozen=True, eq=False)
class Bode:
    """A frequency response as people draw it."""

    magnitude: FloatArray  # (k,)
    phase_deg: FloatArray  # (k,) unwrapped


@dataclass(frozen=True)
class NumberedMode:
    """A mode at one station."""

    json_keys: ClassVar = keys("number", "frequency_hz", "damping_ratio", "kind")

    number: int | None  # as over the whole bed, by frequency at its centre; None: the drive's own, electrical
    frequency_hz: float
    damping_ratio: float
    kind: str
    axis: str | None = None  # "x": seen along this axis only

    @property
    def sign(self) -> str:
        """Label in figures."""
        return "D" if self.number is None else str(self.number or "–")

    @property
    def rings(self) -> bool:
        """Whether the mode makes a peak."""
        return self.damping_ratio < RINGS


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


@dataclass(frozen=True, eq=False)
class Study:
    """All stations of a view."""

    machine: Machine
    view: View
    frequency_hz: FloatArray  # (k,)
    stations: tuple[Station, ...]
    left_out: tuple[str, ...]  # sentences: measured responses that are not of this view

    @property
    def compared(self) -> list[Compared]:
        """Every measured response of the view."""
        return [each for station in self.stations for each in station.compared]


def study(
    machine: Machine,
    view: View,
    frequency_hz: FloatArray,
    places: Sequence[FloatArray],
    measured: Sequence[FrequencyResponse] = (),
) -> Study:
    """Evaluate a view at every requested and every measured position (or with every measured mass)."""
    if not machine.vibration.position_dependent:
        _straight_view(view)
        centre = machine.kinematics.centre_mm
        places, measured = [np.array(centre)], [_of_axes(response, centre) for response in measured]
    fitting = [(response, pair) for response in measured if (pair := _pair(view, response)) is not None]
    left_out = tuple(_left_out(view, response) for response in measured if _pair(view, response) is None)
    for response, _ in fitting:
        _within_reach(machine, response)
    cases = _cases(view, places, [response for response, _ in fitting])
    model = _Model(machine, view, frequency_hz)
    stations = []
    for xy, mass in cases:
        here = [(r, pair) for r, pair in fitting if _belongs(view, r, xy, mass)]
        compared = tuple(_compare(machine, view, response, pair) for response, pair in here)
        stations.append(model.station(xy, mass, compared))
    return Study(machine, view, frequency_hz, tuple(stations), left_out)


def _of_axes(response: FrequencyResponse, centre_mm: tuple[float, float]) -> FrequencyResponse:
    """Rename the carriages of straight axes to the axes, A to x; every place counts as the centre."""
    names = dict(zip(CARRIAGES, AXES, strict=True))
    commanded, answers = (name[:-1] + names.get(name[-1], name[-1]) for name in (response.input, response.output))
    return replace(response, input=commanded, output=answers, position_mm=(*centre_mm, 0.0))


def _straight_view(view: View) -> None:
    if view.answering == "carriage" or view.per == "carriage":
        raise MachineFileError(
            f"--of {view.of}",
            ["This machine's axes are described by modes, not by carriages and an effector: look at --of nozzle."],
        )


def view_of(response: FrequencyResponse) -> View:
    """Return the view that a measured response belongs to."""
    if response.setup == "effector":
        return View("effector-alone")
    if response.setup != "assembly":
        return View("carriage-alone")
    answers, commanded = response.output[-1], response.input[-1]
    return View("carriage" if answers in CARRIAGES else "nozzle", "carriage" if commanded in CARRIAGES else "nozzle")


def verdict(study: Study) -> str:
    """Summarise a study in one sentence."""
    return _measured_verdict(study.compared) if study.compared else _model_verdict(study)


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


def _model_verdict(study: Study) -> str:
    ringing = [mode.frequency_hz for s in study.stations for mode in s.modes if mode.rings]
    if not ringing:
        return "Nothing rings: every mode is damped by more than 30 %."
    slow, fast = min(ringing), max(ringing)
    rings = f"Rings at {slow:.0f} Hz" if fast - slow < 0.5 else f"Rings between {slow:.0f} and {fast:.0f} Hz"
    if study.view.unit != "mm/mm":
        return f"{rings}."
    peak, hz, name, where = max(
        (_loudest(study, s, pair) for s in study.stations for pair in study.view.pairs), key=lambda each: each[0]
    )
    return f"{rings}; at worst {name} answers {peak:.1f} times its command, at {hz:.0f} Hz, {where}."


def _loudest(study: Study, station: Station, pair: Pair) -> tuple[float, float, str, str]:
    magnitude = np.abs(station.value[:, *pair])
    at = int(np.argmax(magnitude))
    return float(magnitude[at]), float(study.frequency_hz[at]), study.view.rows[pair[0]], station.label


def _cases(
    view: View, places: Sequence[FloatArray], measured: Sequence[FrequencyResponse]
) -> list[tuple[FloatArray, float]]:
    """List (position, added mass), without repeats."""
    if not view.depends_on_place:
        alone = {round(r.added_mass_kg, 6) for r in measured}
        return [(np.zeros(2), mass) for mass in sorted(alone or {0.0})]
    wanted = [*places, *(_place(r) for r in measured)]
    distinct: list[FloatArray] = []
    for place in wanted or [np.zeros(2)]:
        if not any(np.abs(place - other).max() <= SAME_PLACE_MM for other in distinct):
            distinct.append(place)
    return [(place, 0.0) for place in distinct]


def _place(response: FrequencyResponse) -> FloatArray:
    return np.array((response.position_mm or (0.0, 0.0))[:2])


def _within_reach(machine: Machine, response: FrequencyResponse) -> None:
    try:
        machine.kinematics.check_reach(np.array([[*_place(response), 0.0]]))
    except UnreachableError as error:
        raise MeasurementError(response.source, [f"{response.input} to {response.output}: {error}"]) from None


def _belongs(view: View, response: FrequencyResponse, xy: FloatArray, mass: float) -> bool:
    if view.depends_on_place:
        return bool(np.abs(_place(response) - xy).max() <= SAME_PLACE_MM)
    return abs(response.added_mass_kg - mass) < 1e-6


def _pair(view: View, response: FrequencyResponse) -> Pair | None:
    """Return row and column of a measured response in the view; None: it is not in it."""
    of, per = view_of(response).of, view_of(response).per
    if view.of == "carriage-alone" and of == view.of:
        return 0, 0
    answers, commanded = response.output[-1], response.input[-1]
    if view.of == "effector-alone" and of == view.of and answers == commanded:
        return AXES.index(answers), AXES.index(answers)
    nozzle = view.of in ("nozzle", "acceleration") and of == "nozzle"
    if response.input.startswith("cmd_") and per == view.per and (nozzle or of == view.of == "carriage"):
        return view.rows.index(answers), view.columns.index(commanded)
    return None


def _left_out(view: View, response: FrequencyResponse) -> str:
    if response.setup == "assembly" and not response.input.startswith("cmd_"):
        return f"{response.source}: {response.input} to {response.output} answers no command, so it is of no view here."
    fits = view_of(response)
    per = f" --per {fits.per}" if fits.depends_on_place else ""
    return (
        f"{response.source}: {response.input} to {response.output} ({response.setup}) is not a response of this view "
        f"(--of {view.of}); look at it with --of {fits.of}{per}."
    )


def _compare(machine: Machine, view: View, response: FrequencyResponse, pair: Pair) -> Compared:
    """Compare in the view's unit: an acceleration per position becomes the position, or the other way round."""
    there = np.abs(response.value) > 0  # a line of nothing has no relative error
    s = response.s[there]
    is_acceleration = response.output.startswith("acc_")
    wants_acceleration = view.of in ("acceleration", "effector-alone")
    factor = s ** (2.0 * (wants_acceleration - is_acceleration))
    measured, ours = response.value[there] * factor, predicted(machine, [response])[0][there] * factor
    magnitude, phase = mean_absolute_percentage_accuracy(measured, ours)
    decibel = log_error_db(measured, ours)
    return Compared(response, pair, response.frequency_hz[there], measured, ours, magnitude, phase, decibel)


_Case = tuple[str, ComplexArray, tuple[NumberedMode, ...]]  # label, response, modes


@dataclass(frozen=True, eq=False)
class _Model:
    """Everything that all stations share."""

    machine: Machine
    view: View
    frequency_hz: FloatArray  # (k,)

    def station(self, xy: FloatArray, mass: float, compared: tuple[Compared, ...]) -> Station:
        """Evaluate the model at one position, or with one mass."""
        evaluate = {"carriage-alone": self._carriage, "effector-alone": self._effector}.get(
            self.view.of, self._assembly
        )
        label, value, modes = evaluate(xy, mass)
        carriage = self.machine.vibration.frequency_response(xy, self.frequency_hz)
        return Station(label, xy, mass, value, carriage, modes, compared)

    def _assembly(self, xy: FloatArray, _: float) -> _Case:
        value = self.machine.vibration.frequency_response(xy, self.frequency_hz, self.view.answering, self.view.per)
        if not self.machine.vibration.position_dependent:
            return "anywhere", value, _straight_modes(self.machine.vibration.modes_at(xy))
        return f"at ({xy[0]:g}, {xy[1]:g}) mm", value, _assembly_modes(self.machine, xy)

    def _carriage(self, _: FloatArray, mass: float) -> _Case:
        value = command_frf(with_added_mass(delta_vibration(self.machine).carriage, mass), self._s)[:, None, None]
        label = f"with {1e3 * mass:g} g more" if mass else "without added mass"
        return label, value, _carriage_mode(self.machine, mass)

    def _effector(self, _: FloatArray, __: float) -> _Case:
        value = delta_vibration(self.machine).struck_frf(self._s)[:, :, None] * np.eye(3)
        return "by itself", value, _effector_modes(self.machine)

    @property
    def _s(self) -> ComplexArray:
        return np.asarray(2j * np.pi * self.frequency_hz, dtype=np.complex128)


def _assembly_modes(machine: Machine, xy: FloatArray) -> tuple[NumberedMode, ...]:
    """Give modes the numbers they have over the whole bed, so that one number is one mode at every position."""
    modes = machine.vibration.modes_at(xy)
    each = zip(
        numbers(delta_vibration(machine), xy),
        modes.frequencies_hz.tolist(),
        modes.damping_ratios.tolist(),
        kinds(delta_vibration(machine), xy, modes),
        strict=True,
    )
    return (*(NumberedMode(*row) for row in sorted(each)), *_drive_mode(machine))


def _straight_modes(modes: Modes) -> tuple[NumberedMode, ...]:
    """Give the modes of modal axes their numbers: each along one axis alone, wherever the nozzle is."""
    along = np.argmax(np.abs(modes.nozzle), axis=1)
    each = zip(modes.frequencies_hz.tolist(), modes.damping_ratios.tolist(), along.tolist(), strict=True)
    return tuple(NumberedMode(i, f, z, f"along {AXES[a]}", AXES[a]) for i, (f, z, a) in enumerate(each, 1))


def _drive_mode(machine: Machine) -> tuple[NumberedMode, ...]:
    """Return the pole of Eq. 34: ω = √d₀, ζ = d₂/(2 √d₀)."""
    drive = delta_vibration(machine).carriage.drive
    if drive is None or drive.d2_per_s >= 2 * np.sqrt(drive.d0_per_s2):
        return ()
    omega = np.sqrt(drive.d0_per_s2)
    return (NumberedMode(None, float(omega / (2 * np.pi)), float(drive.d2_per_s / (2 * omega)), "drive"),)


def _carriage_mode(machine: Machine, mass: float) -> tuple[NumberedMode, ...]:
    """Return ω_n = √(k/m), ζ = (c + b)/(2 √(k m)) (Eqs. 35, 36)."""
    m, k = (
        delta_vibration(machine).carriage.moving_mass_kg + mass,
        delta_vibration(machine).carriage.belt_stiffness_n_per_m,
    )
    zeta = damping(delta_vibration(machine).carriage) / (2 * np.sqrt(k * m))
    return (NumberedMode(1, float(np.sqrt(k / m) / (2 * np.pi)), float(zeta), "on its belt"), *_drive_mode(machine))


def _effector_modes(machine: Machine) -> tuple[NumberedMode, ...]:
    """Return ω_p of Eq. 48 along each axis, ζ = b ω_p/(2 k), slowest first."""
    effector = delta_vibration(machine).effector
    m1, m2, k = effector.nozzle_mass_kg, effector.extruder_mass_kg, effector.extruder_stiffness_n_per_m
    omega = np.sqrt((m1 + m2) * k / (m1 * m2))
    zeta = effector.extruder_damping_n_s_per_m * omega / (2 * k)
    modes = sorted(zip((omega / (2 * np.pi)).tolist(), zeta.tolist(), AXES, strict=True))
    return tuple(NumberedMode(number, f, z, f"along {axis}", axis) for number, (f, z, axis) in enumerate(modes, 1))


def bodes(g: ComplexArray) -> list[list[Bode]]:
    """Return responses (k, r, c) as rows of columns."""
    phase = np.degrees(np.unwrap(np.angle(g), axis=0))
    return [[Bode(np.abs(g[:, i, k]), phase[:, i, k]) for k in range(g.shape[2])] for i in range(g.shape[1])]
