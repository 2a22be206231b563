"""What an effect declares: its physics in words, its parameters, what it looks like in data, and its rivals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from models.arrays import FloatArray, constant
from models.machine import Machine

Kind = Literal["parameter", "force", "command", "frame", "sensor"]
Size = Literal["scalar", "per_tower", "vector3", "direction"]

DIRECTIONS: Mapping[str, tuple[tuple[float, float], ...]] = {
    "x": ((1.0, 0.0),),
    "y": ((0.0, 1.0),),
    "both": ((1.0, 0.0), (0.0, 1.0)),
}
UNIT_TOLERANCE = 1e-3  # a unit vector written with four digits is one


@dataclass(frozen=True)
class Parameter:
    """One key of `[effects.name]`.

    An amplitude's answer grows as `value ** power` while it is small, and the effect is gone at `neutral`; every
    other parameter only shapes the answer.
    """

    name: str
    unit: str  # '' for a ratio
    meaning: str
    bounds: tuple[float, float]  # what a machine file may say
    typical: tuple[float, float]  # what printers have
    probe: float  # amplitude: a value that shows and is still small; shape: a step for finite differences
    size: Size = "scalar"
    role: Literal["amplitude", "shape"] = "amplitude"
    power: int = 1
    default: float | None = None  # of a shape that a machine file need not give
    logarithmic: bool = False  # a shape that is known by its order of magnitude only
    starts: tuple[float, ...] = ()  # of a shape: where a search must begin, if its usual range does not tell

    @property
    def neutral(self) -> float:
        """The value of an amplitude without effect."""
        return 0.0 if self.power > 0 else math.inf

    @property
    def absent(self) -> Any:
        """What a parameter means that is left out of the file."""
        value = self.neutral if self.default is None else self.default
        return [value] * 3 if self.size == "vector3" else value

    def numbers(self, value: Any) -> FloatArray:
        """The value as arrays are wanted: scalar (); per tower or vector (3,); direction (1 or 2, 2) unit vectors."""
        if self.size == "direction":
            return np.array(DIRECTIONS[value] if isinstance(value, str) else [value], dtype=np.float64)
        return np.array(np.broadcast_to(value, 3 if self.size == "per_tower" else np.shape(value)), dtype=np.float64)

    def problem(self, value: Any) -> str:
        """Which rule a value in a machine file breaks, as the end of a sentence; '' if none."""
        if self.size == "direction":
            return "" if _is_direction(value) else "must be 'x', 'y', 'both', or a unit vector [x, y]"
        if not self._has_size(value):
            return SIZES[self.size].format(unit=self._unit)
        return self._range_problem(value if isinstance(value, list) else [value])

    def _has_size(self, value: Any) -> bool:
        if isinstance(value, list):
            return self.size != "scalar" and len(value) == 3 and all(map(_is_number, value))
        return self.size != "vector3" and _is_number(value)

    def _range_problem(self, values: list[float]) -> str:
        low, high = self.bounds
        if min(values) < low:
            return f"must be at least {low:g}{self._unit}"
        return f"must be at most {high:g}{self._unit}" if max(values) > high else ""

    @property
    def _unit(self) -> str:
        return f" ({self.unit})" if self.unit else ""


SIZES: Mapping[Size, str] = {
    "scalar": "must be a finite number{unit}",
    "per_tower": "must be a finite number{unit}, or a list of three, one a tower",
    "vector3": "must be a list of three finite numbers{unit}",
}


@dataclass(frozen=True)
class Signals:
    """What the accelerometers record, or would record if they were perfect."""

    t_s: FloatArray  # (n,)
    carriage: FloatArray  # (n, 3) m/s², columns A B C
    nozzle: FloatArray  # (n, 3) m/s², columns X Y Z


@dataclass(frozen=True)
class Effect:
    """One way in which a printer differs from the model.

    A `parameter` effect changes the machine's numbers, by `fold`; a `sensor` effect changes what is recorded of a
    motion, by `measure`; a `force`, `command` or `frame` effect is a term of `models/printer/kernels`.
    """

    name: str  # of its table in a machine file, and of its file here
    title: str
    kind: Kind
    physics: str
    equation: str
    parameters: tuple[Parameter, ...]
    in_data: str  # what to look for
    # effect, or number of the machine, that it is taken for -> how to tell them apart
    rivals: Mapping[str, str] = field(default_factory=dict)
    fold: Callable[[Machine, Mapping[str, FloatArray]], Machine] | None = None
    measure: Callable[[Signals, Mapping[str, FloatArray]], Signals] | None = None

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; KeyError if there is none."""
        return self.by_name[name]

    @property
    def by_name(self) -> dict[str, Parameter]:
        return {parameter.name: parameter for parameter in self.parameters}

    @property
    def amplitudes(self) -> tuple[Parameter, ...]:
        return tuple(parameter for parameter in self.parameters if parameter.role == "amplitude")

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        return tuple(parameter for parameter in self.parameters if parameter.role == "shape")

    def missing(self, table: Mapping[str, Any]) -> list[str]:
        """Shape parameters a table must still give: all without a default, once it gives an amplitude."""
        if not any(amplitude.name in table for amplitude in self.amplitudes):
            return []
        return [shape.name for shape in self.shapes if shape.default is None and shape.name not in table]


def same_or_each(values: FloatArray) -> Any:
    """(3,) per tower → the one number if all agree, else the read-only array: what a carriage's numbers may be."""
    return float(values[0]) if np.all(values == values[0]) else constant(values)


def resampled(signals: Signals, t_s: FloatArray) -> Signals:
    """The signals at other times, by cubic splines; outside the recording its first and last values hold."""
    from scipy.interpolate import CubicSpline  # 0.3 s to import: only when a sensor is really simulated

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
