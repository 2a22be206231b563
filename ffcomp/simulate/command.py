"""A command over time, whatever its source, and the reference path of the nozzle.

mm, s. Actuators in the order A, B, C.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.metrics import peak_acceleration
from models.arrays import FloatArray
from models.printer.printer import Hold

OfTime = Callable[[FloatArray], FloatArray]  # t : (k,) s → (k, 3) mm

EFFORT_S, EFFORT_SAMPLE_S = 0.004, 0.001  # speeds and accelerations of commands are differences over such a time


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """The reference path, on its own plan's clock."""

    position: OfTime  # where the nozzle should be at times of the command's clock
    plan_time: Callable[[FloatArray], FloatArray]  # times of the command's clock on the plan's, (k,) s → (k,) s
    corners: Callable[[float, float], tuple[FloatArray, FloatArray]]  # from, to (plan's clock) → (n,) s, (n, 3) mm


@dataclass(frozen=True, eq=False)
class CommandSection:
    """A command from rest to rest during which nothing else moves the nozzle; it rests before and after."""

    begin_s: float
    end_s: float
    rows: Callable[[FloatArray, float], FloatArray]  # even times (k,) s and their step → (k, 3) mm, as executed
    actuators: OfTime  # the commanded actuator positions without microsteps, at any time
    reference: ReferencePath


@dataclass(frozen=True, eq=False)
class Command:
    """Sections of a command in the order of time."""

    sections: Sequence[CommandSection]
    hold: Hold  # how it runs from row to row
    reference: str  # a sentence: the path that the nozzle is evaluated against

    def between(self, from_s: float, to_s: float) -> list[tuple[CommandSection, float, float]]:
        """Return the sections of a part of the time, each with the part's begin and end in it."""
        parts = [(s, max(s.begin_s, from_s), min(s.end_s, to_s)) for s in self.sections]
        return [(section, begin, end) for section, begin, end in parts if begin < end]


def command_peaks(actuators: OfTime, begin_s: float, end_s: float) -> tuple[float, float]:
    """Return the largest speed, mm/s, and acceleration, mm/s², that a command demands of any actuator.

    Both are differences over the time of one segment.
    """
    span = round(EFFORT_S / EFFORT_SAMPLE_S)
    t = begin_s + EFFORT_SAMPLE_S * np.arange(max((end_s - begin_s) / EFFORT_SAMPLE_S, 2 * span) + 1)
    position = actuators(t)
    speed = float(np.abs(position[span:] - position[:-span]).max()) / EFFORT_S
    return speed, peak_acceleration(position, EFFORT_SAMPLE_S, EFFORT_S)
