"""Define the declaration of an effect: physics, parameters, appearance in data, and confounded effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np

from models.arrays import FloatArray
from models.machine import Machine
from models.quantities import PLAIN, Quantities

Kind = Literal["parameter", "force", "command", "frame", "sensor"]
Size = Literal["scalar", "per_tower", "vector3", "direction", "lines"]
MOST_LINES = 8
EACH: Size = "per_tower"

DIRECTIONS: Mapping[str, tuple[tuple[float, float], ...]] = {
    "x": ((1.0, 0.0),),
    "y": ((0.0, 1.0),),
    "both": ((1.0, 0.0), (0.0, 1.0)),
}
PER_KILOGRAM = "_per_kg"  # suffix of a key for a force per moving kilogram
UNIT_TOLERANCE = 1e-3  # a unit vector written with four digits is one

Values = Mapping[str, FloatArray]  # an effect's parameters as in a machine file
Terms = Mapping[str, Any]  # numbers of the printers' equations by name, SI: `models/printer/kernels/record.py`


@dataclass(frozen=True)
class MotionScales:
    """Magnitudes of a motion of one axis by itself, SI."""

    force_n: float
    speed_m_per_s: float
    way_m: float  # rms about the middle
    travel_m: float  # from end to end
    stretch_m: float  # of the spring at the end; without one, `way_m`
    stiffness_n_per_m: float = 0.0  # of that spring
    highest_hz: float = math.inf  # frequency that is compared


@dataclass(frozen=True)
class EffectParameter:
    """One key of `[effects.name]`.

    The response to an amplitude grows as `value ** power` while small, and is zero at `neutral`. Every other parameter
    only shapes the response.
    """

    name: str
    unit: str  # '' for a ratio
    meaning: str
    bounds: tuple[float, float]  # allowed in a machine file
    typical: tuple[float, float]  # of real printers
    probe: float  # amplitude: a small value whose response is still clear; shape: a step for finite differences
    size: Size = "scalar"
    role: Literal["amplitude", "shape"] = "amplitude"
    power: int = 1
    default: float | None = None  # of a shape that is optional in a machine file
    logarithmic: bool = False  # a shape that is known by its order of magnitude only
    starts: tuple[float, ...] = ()  # of a shape: starts of a search, instead of its typical range
    on_printers: tuple[float, float] | None = None  # where a diagnosis looks for it, if not in all of `bounds`
    # where a diagnosis looks for it on an axis by itself, which may be of any size
    usual: Callable[[MotionScales], float] | None = None  # size that rivals the axis' own forces; None: not on an axis
    tried: Callable[[MotionScales], Sequence[float]] | None = None  # starts of the search for a shape
    lowest: float | None = None  # in place of the lower one of `bounds`
    signals: tuple[str, ...] = ("acc_q",)  # one for each number of a vector

    def on(self, quantities: Quantities) -> EffectParameter:
        """Return the parameter with the keys, units and numbers of an axis, for display only."""
        scale = quantities.scale(self.name)
        low, high = self.typical
        unit, key = quantities.unit(self.unit), quantities.key(self.name)
        return replace(self, name=key, unit=unit, typical=(scale * low, scale * high))

    @property
    def neutral(self) -> float:
        """The value of an amplitude without effect."""
        return 0.0 if self.power > 0 else math.inf

    @property
    def is_needed(self) -> bool:
        """Whether there is no such effect without it; others have a usual value."""
        return self.role == "amplitude" or self.default is None

    @property
    def is_pitch(self) -> bool:
        """Whether it is the distance after which something repeats."""
        return self.name == "pitch_mm"

    @property
    def of_mass(self) -> bool:
        """Whether it is a force or a mass, which is per kilogram on axes of unknown mass."""
        return self.unit.startswith(("N", "kg"))

    @property
    def absent(self) -> Any:
        """The value if the file has none."""
        value = self.neutral if self.default is None else self.default
        return [value] * 3 if self.size == "vector3" else value

    def as_array(self, value: Any) -> FloatArray:
        """Convert the value: scalar to (); per tower or vector to (3,); direction to (1 or 2, 2) unit vectors."""
        if self.size == "direction":
            return np.array(DIRECTIONS[value] if isinstance(value, str) else [value], dtype=np.float64)
        shape: Any = {"per_tower": 3, "lines": np.shape(np.atleast_1d(value))}.get(self.size, np.shape(value))
        return np.array(np.broadcast_to(value, shape), dtype=np.float64)

    def problem(self, value: Any) -> str:
        """Return the rule that a value breaks, as the end of a sentence; '' if none."""
        if self.size == "direction":
            return "" if _is_direction(value) else "must be 'x', 'y', 'both', or a unit vector [x, y]"
        if not self._has_size(value):
            return SIZES[self.size].format(unit=self._unit)
        (low, high), values = self.bounds, value if isinstance(value, list) else [value]
        if min(values) < low:
            return f"must be at least {low:g}{self._unit}"
        return f"must be at most {high:g}{self._unit}" if max(values) > high else ""

    def _has_size(self, value: Any) -> bool:
        if isinstance(value, list):
            counts = range(1, MOST_LINES + 1) if self.size == "lines" else (3,)
            return self.size != "scalar" and len(value) in counts and all(map(_is_number, value))
        return self.size != "vector3" and _is_number(value)

    @property
    def _unit(self) -> str:
        return f" ({self.unit})" if self.unit else ""


def amplitude(name: str, *declared: Any, unit: str | None = None, **more: Any) -> EffectParameter:
    """Declare an amplitude by the fields of `EffectParameter` from `meaning` on; `unit` where the name has none."""
    return EffectParameter(name, PLAIN.unit_of(name) if unit is None else unit, *declared, **more)


shape = partial(amplitude, role="shape")  # declares a shape in the same way


AT_DRIVE = shape(
    "at_drive", "1: of the drive of an axis with a load; else of its coupling", (0, 1), (0, 1), 1.0, default=0.0
)

SIZES: Mapping[Size, str] = {
    "scalar": "must be a finite number{unit}",
    "per_tower": "must be a finite number{unit}, or a list of three, one a tower",
    "vector3": "must be a list of three finite numbers{unit}",
    "lines": f"must be a finite number{{unit}}, or a list of up to {MOST_LINES}, one for each line",
}


@dataclass(frozen=True)
class Signals:
    """Signals of the accelerometers, of ideal ones or as recorded."""

    t_s: FloatArray  # (n,)
    carriage: FloatArray  # (n, 3) m/s², columns A B C
    nozzle: FloatArray  # (n, 3) m/s², columns X Y Z
    position: FloatArray = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) mm of an axis by itself, its motor


@dataclass(frozen=True)
class Effect:
    """One deviation of a printer from the model.

    It changes the machine's parameters (`fold`) or the recorded signals (`measure`), or it is a term of
    `models/printer/kernels` with the numbers of `terms`.
    """

    name: str  # of its table in a machine file
    title: str
    physics: str
    equation: str
    parameters: tuple[EffectParameter, ...]
    in_data: str  # its signature
    # confounded effect, or machine parameter -> how to separate them
    confounded_with: Mapping[str, str] = field(default_factory=dict)
    remedy: str = ""  # what to do to the printer; {where}: ", first of A and B"
    fold: Callable[[Machine, Values], Machine] | None = None
    measure: Callable[[Signals, Values], Signals] | None = None
    terms: Callable[[Values, Terms], Terms] | None = None  # from its values and the printer's terms so far
    acts_on: Literal["force", "command", "frame"] = "force"  # of a term
    of_axis: tuple[EffectParameter, ...] = ()  # shapes of an axis by itself only
    of_printers: tuple[EffectParameter, ...] = ()  # shapes of printers only
    of: tuple[str, ...] = ("carriages", "axes")  # `VibrationModel.moves` of the machines that may have it
    # how far positions must be apart along x, y, z, over all recordings, to identify it
    spread_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # requirements on an axis by itself
    needs: Literal["", "spring", "command", "freedom", "turning", "accelerometer", "two sensors"] = ""
    family: str = ""  # the physical cause, whatever the law; printed before the name
    law_of: str = ""  # laws of one cause differ by little: they never combine and are no rivals of each other
    corrects_file: bool = False  # it only corrects a number of the machine file
    of_motors: bool = False  # its values belong to belts and motors, not to carriages or axes
    shifts_time: bool = False  # a recorded sample depends on others than itself

    @property
    def one_law(self) -> bool:
        """Whether no other law of it is known: a number that is off, a recorded signal, a delay."""
        return bool(self.fold or self.measure) or self.law_of == "lateness"

    @property
    def kind(self) -> Kind:
        """Return what it changes: parameters, signals, or where its term acts."""
        return "parameter" if self.fold else "sensor" if self.measure else self.acts_on

    @property
    def cause(self) -> str:
        """What laws of one cause share; of any other effect its own name."""
        return self.law_of or self.name

    @cached_property
    def by_name(self) -> dict[str, EffectParameter]:
        """All parameters by name, those of an axis by itself or of printers only too."""
        return {parameter.name: parameter for parameter in (*self.parameters, *self.of_printers, *self.of_axis)}

    @cached_property
    def amplitudes(self) -> tuple[EffectParameter, ...]:
        """The parameters that make the effect."""
        return tuple(parameter for parameter in self.parameters if parameter.role == "amplitude")

    @cached_property
    def shapes(self) -> tuple[EffectParameter, ...]:
        """All other parameters."""
        return tuple(parameter for parameter in self.parameters if parameter.role == "shape")

    def on_axis(self, quantities: Quantities) -> Effect:
        """Return the effect with the keys and units of one axis by itself."""
        parameters, of_axis = (tuple(p.on(quantities) for p in each) for each in (self.parameters, self.of_axis))
        return replace(self, parameters=parameters, of_axis=of_axis, of_printers=())

    def missing(self, table: Mapping[str, Any]) -> list[str]:
        """Name the missing shapes: with an amplitude, a table needs all that have no default."""
        if not any(amplitude.name in table for amplitude in self.amplitudes):
            return []
        return [shape.name for shape in self.shapes if shape.default is None and shape.name not in table]


def resampled(signals: Signals, t_s: FloatArray) -> Signals:
    """Interpolate the signals at other times by cubic splines; hold the first and last values outside."""
    from scipy.interpolate import CubicSpline  # 0.3 s to import, needed for sensors only

    inside = np.clip(t_s, signals.t_s[0], signals.t_s[-1])
    carriage, nozzle = (CubicSpline(signals.t_s, values)(inside) for values in (signals.carriage, signals.nozzle))
    return replace(signals, carriage=carriage, nozzle=nozzle)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_direction(value: Any) -> bool:
    if isinstance(value, str):
        return value in DIRECTIONS
    is_pair = isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))
    return is_pair and abs(math.hypot(*value) - 1) <= UNIT_TOLERANCE
