"""A command over time, whatever its source, and the reference path of the nozzle.

mm, s. Actuators in the order A, B, C.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.metrics import peak_acceleration
from ffcomp.planner.trajectory import PlannedMotion
from models.arrays import BoolArray, FloatArray
from models.machine import Machine
from models.printer.printer import Hold

OfTime = Callable[[FloatArray], FloatArray]  # t : (k,) s → (k, 3) mm

DIFFERENCE_S, SAMPLE_S = 0.004, 0.001  # speeds and accelerations of commands are differences over such a time


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
    span = round(DIFFERENCE_S / SAMPLE_S)
    t = begin_s + SAMPLE_S * np.arange(max((end_s - begin_s) / SAMPLE_S, 2 * span) + 1)
    position = actuators(t)
    speed = float(np.abs(position[span:] - position[:-span]).max()) / DIFFERENCE_S
    return speed, peak_acceleration(position, SAMPLE_S, DIFFERENCE_S)


@dataclass(frozen=True, slots=True)
class SectionClock:
    """Alignment of an executed motion with the reference plan, section by section.

    Section i of m begins at executed_t[i], which is plan_t[i] on the plan's clock. The reference moves only from
    begin_t[i] to end_t[i] of that clock, and rests around it. Where a section takes another time than planned
    (`retimed`), the plan's time is that of the place on the path where the command is.
    """

    executed_t: FloatArray  # (m,) s
    plan_t: FloatArray  # (m,) s
    begin_t: FloatArray  # (m,) s
    end_t: FloatArray  # (m,) s
    retimed: BoolArray | None = None  # (m,); None: no section is
    passed_t: FloatArray | None = None  # (k,) s, when the command passes some places,
    due_t: FloatArray | None = None  # (k,) s, and when the plan does

    def plan_time(self, t: FloatArray) -> FloatArray:
        """Return the plan's time at each executed time, (k,) s → (k,) s."""
        i = np.maximum(np.searchsorted(self.executed_t, t, side="right") - 1, 0)
        planned = self.plan_t[i] + (t - self.executed_t[i])
        if self.retimed is not None and self.passed_t is not None and self.due_t is not None:
            planned = np.where(self.retimed[i], np.interp(t, self.passed_t, self.due_t), planned)
        return np.clip(planned, self.begin_t[i], self.end_t[i])


@dataclass(frozen=True, slots=True)
class Motion:
    """The nozzle's command at any time from begin_t to end_t, and its alignment with the reference plan."""

    position: OfTime
    begin_t: float  # s
    end_t: float  # s
    clock: SectionClock

    def actuators(self, machine: Machine) -> Callable[[FloatArray], FloatArray]:
        """Return the actuators' command at times (k,) s, by the inverse kinematics that the firmware believes in."""
        kinematics = machine.kinematics.compiled()
        return lambda t: kinematics.inverse(np.ascontiguousarray(self.position(t)))

    def peaks(self, machine: Machine) -> tuple[float, float]:
        """Return the largest speed, mm/s, and acceleration, mm/s², that it demands of any actuator."""
        return command_peaks(self.actuators(machine), self.begin_t, self.end_t)


def motion_of(trajectory: PlannedMotion, clock: SectionClock) -> Motion:
    """Execute a plan as it stands."""
    begin, end = float(trajectory.start_t[0]), trajectory.end_t
    return Motion(lambda t: trajectory.position(np.clip(t, begin, end))[:, :3], begin, end, clock)


def reference_clock(trajectory: PlannedMotion) -> SectionClock:
    """Return the clock of the reference plan itself."""
    begin, end = trajectory.start_t[:1], np.array([trajectory.end_t])
    return SectionClock(begin, begin, begin, end)


def planned_motion(trajectory: PlannedMotion) -> Motion:
    """Execute the reference plan itself, on its own clock."""
    return motion_of(trajectory, reference_clock(trajectory))


def path_corners(trajectory: PlannedMotion) -> tuple[FloatArray, FloatArray]:
    """Return when each corner of the path is due (n + 1,) s, and where it is (n + 1, 3) mm."""
    end = trajectory.position(np.array([trajectory.end_t]))
    return np.append(trajectory.start_t, trajectory.end_t), np.vstack([trajectory.origin, end])[:, :3]


def path_corners_with_rests(trajectory: PlannedMotion) -> tuple[FloatArray, FloatArray]:
    """Return when each straight move begins and ends (2 n,) s, and where (2 n, 3) mm: a rest is a corner twice."""
    end_t = trajectory.start_t + trajectory.duration
    ends = trajectory.position(np.nextafter(end_t, -np.inf))[:, :3]
    t = np.stack([trajectory.start_t, end_t], axis=1).ravel()
    return t, np.stack([trajectory.origin[:, :3], ends], axis=1).reshape(-1, 3)
