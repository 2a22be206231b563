"""What the motors are told over time, wherever it comes from, and where the nozzle is meant to be.

mm, s. Carriages in the order A, B, C.
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
class Goal:
    """The wanted path, on its own clock."""

    position: OfTime  # where the nozzle should be at times of the command's clock
    due: Callable[[FloatArray], FloatArray]  # these times on the path's own clock, (k,) s → (k,) s
    path: Callable[[float, float], tuple[FloatArray, FloatArray]]  # from, to (path's clock) → corners (n,) s, (n, 3) mm


@dataclass(frozen=True, eq=False)
class Stretch:
    """A command from rest to rest in which nobody else moves the nozzle; before and after it, it rests."""

    begin_s: float
    end_s: float
    rows: Callable[[FloatArray, float], FloatArray]  # even times (k,) s and their step → (k, 3) mm, what is played
    meant: OfTime  # the carriages' command without microsteps, at any time
    goal: Goal


@dataclass(frozen=True, eq=False)
class Command:
    stretches: Sequence[Stretch]
    hold: Hold  # how it runs from row to row
    reference: str  # a sentence: what the nozzle is judged against

    def between(self, from_s: float, to_s: float) -> list[tuple[Stretch, float, float]]:
        """The stretches of a part of the time, each with the part's begin and end in it."""
        parts = [(s, max(s.begin_s, from_s), min(s.end_s, to_s)) for s in self.stretches]
        return [(stretch, begin, end) for stretch, begin, end in parts if begin < end]


def peaks(meant: OfTime, begin_s: float, end_s: float) -> tuple[float, float]:
    """The largest speed, mm/s, and acceleration, mm/s², that any carriage is asked for in this time."""
    span = round(EFFORT_S / EFFORT_SAMPLE_S)
    t = begin_s + EFFORT_SAMPLE_S * np.arange(max((end_s - begin_s) / EFFORT_SAMPLE_S, 2 * span) + 1)
    carriages = meant(t)
    speed = float(np.abs(carriages[span:] - carriages[:-span]).max()) / EFFORT_S
    return speed, peak_acceleration(carriages, EFFORT_SAMPLE_S, EFFORT_S)
