"""How large the hidden effects of a kind of printer are drawn, and how its machine files tell of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from validation.blind.printer.real import FloatArray, Real, Rng

Range: TypeAlias = tuple[float, float]  # drawn evenly between
Table: TypeAlias = dict[str, Any]


@dataclass(frozen=True)
class Drawn:
    """One kind of printer. Forces are drawn as numbers times `loads` of the printer, one of each motor."""

    motors: int
    loads: Callable[[Real], FloatArray]  # (motors,), what a force of one is on each motor, N
    forces: Callable[..., Table]  # of a printer and arrays (motors,) by key: a file's table of forces
    uneven: Range  # where motors differ, each is so many times the middle
    friction: Range
    stiction: Range
    grease: Range
    slope_per_m: Range
    centre_mm: Range
    play_mm: Range
    stepper_mm: Range
    ripple_mm: Range
    frame_kg: Range
    frame_hz: Range
    # outside the catalogue
    pulley_m: Range
    pulley_share: Range
    warm_share: Range
    warm_s: Range
    cable_kg: Range
    fan: Range
    fan_felt: tuple[float, ...]  # (6,): 1 where a sensor of carriages or nozzle is
    notch: Range
    bracket: str  # the field that says which motor's bracket is soft
    springs: Callable[[Real], FloatArray]  # (motors,) N/m

    def each(self, rng: Rng, value: float) -> FloatArray:
        """Draw the same for every motor, or as often as not different ones: (motors,)."""
        uneven = rng.uniform(*self.uneven, self.motors)
        return value * (uneven if rng.random() < 0.35 else np.ones(self.motors))

    def some(self, rng: Rng) -> FloatArray:
        """Draw one motor, or all: (motors,), ones and zeros."""
        return np.eye(self.motors)[rng.integers(self.motors)] if rng.random() < 0.5 else np.ones(self.motors)


def told(values: FloatArray) -> Any:
    """Return it as a machine file tells it: one number if all are equal, else a list of three."""
    lacking = [0.0] * (3 - len(values))
    return float(values[0]) if np.ptp(values) == 0 else [*(float(x) for x in values), *lacking]
