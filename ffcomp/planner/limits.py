"""What the firmware allows each move by itself: its top speed and its acceleration.

The rules are those of Klipper's and Kalico's planner (checked against the running host in the tests). Units:
mm, s, mm/s, mm/s²; a limit that does not apply is infinite.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gcode.program import Moves
from models.arrays import BoolArray, FloatArray
from models.compiled import kernel
from models.machine import Machine

SHORTEST_TRAVEL_MM = 1e-9  # a shorter nozzle move counts as extruder-only
NOZZLE_MM, FILAMENT_MM = 0.4, 1.75  # diameters
EXTRUSION_RATIO = 16.0 * NOZZLE_MM**2 / (math.pi * FILAMENT_MM**2)  # of path to filament, four nozzle squares thick
SLOW_RATIOS = ((3.0, 0.5), (6.0, 0.25))  # beyond this carriage speed / nozzle speed, this share is allowed


_Numbers = tuple[float, float, float, float, float, float, float, float, tuple[tuple[float, float], ...]]


class DeltaSlowZones(NamedTuple):
    """The geometry that decides where a delta's firmware slows down."""

    radius_mm: float
    arm_length_mm: float  # the shortest arm
    half_step_mm: float  # half the carriage travel of one step, the smallest of the three

    def radius_of_ratio(self, ratio: float) -> float:
        """Distance from the centre where a carriage may need `ratio` times the nozzle's speed, mm.

        A carriage stands sqrt(L² - rho²) above the lower joint of an arm that leans out by rho. The chord of
        slope `ratio` over one step in rho has its centre at ratio sqrt(L²/(ratio² + 1) - half²), its far end
        half a step further.
        """
        lean = ratio * math.sqrt(self.arm_length_mm**2 / (ratio**2 + 1.0) - self.half_step_mm**2)
        return lean + self.half_step_mm - self.radius_mm


@dataclass(frozen=True, slots=True)
class PlannerLimits:
    """The limits in the firmware's configuration; those in the file come with the moves."""

    velocity_mm_per_s: float
    acceleration_mm_per_s2: float
    square_corner_velocity_mm_per_s: float = 5.0
    minimum_cruise_ratio: float = 0.5
    z_velocity_mm_per_s: float | None = None  # None: as the nozzle
    z_acceleration_mm_per_s2: float | None = None  # None: as the nozzle
    extruder_acceleration_mm_per_s2: float | None = None  # None: acceleration times EXTRUSION_RATIO
    delta: DeltaSlowZones | None = None  # None: no slow zones


class Lines(NamedTuple):
    """n straight moves as geometry."""

    step: FloatArray  # (n, 4) mm, columns X Y Z E: end - start; XYZ zero where the move is extruder-only
    length: FloatArray  # (n,) mm of path; of filament where the move is extruder-only
    direction: FloatArray  # (n, 4) step / length; zero for moves that go nowhere
    travels: BoolArray  # (n,) the nozzle moves


class Bounds(NamedTuple):
    """What each of n moves may do by itself."""

    speed: FloatArray  # (n,) mm/s
    acceleration: FloatArray  # (n,) mm/s²
    smooth_acceleration: FloatArray  # (n,) mm/s², for the pass with the minimum cruise ratio
    junction_deviation: FloatArray  # (n,) mm, from the square corner velocity


def lines_of(moves: Moves) -> Lines:
    """Compute the geometry of the moves, extruder-only ones recognised."""
    return Lines(*_lines(moves.start, moves.end))


@kernel
def _lines(start: FloatArray, end: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    n = len(start)
    step, length, direction, travels = np.empty((n, 4)), np.empty(n), np.zeros((n, 4)), np.empty(n, dtype=np.bool_)
    for i in range(n):
        for c in range(4):
            step[i, c] = end[i, c] - start[i, c]
        x, y, z = step[i, 0], step[i, 1], step[i, 2]
        length[i] = np.sqrt(x * x + y * y + z * z)
        travels[i] = length[i] >= SHORTEST_TRAVEL_MM
        if not travels[i]:
            step[i, 0], step[i, 1], step[i, 2] = 0.0, 0.0, 0.0
            length[i] = abs(step[i, 3])
        if length[i] > 0.0:
            per_mm = 1.0 / length[i]
            for c in range(4):
                direction[i, c] = step[i, c] * per_mm
    return step, length, direction, travels


def bounds_of(moves: Moves, lines: Lines, limits: PlannerLimits) -> Bounds:
    """Every limit on single moves, put together."""
    by_file = moves.velocity_limit, moves.acceleration, moves.square_corner_velocity, moves.minimum_cruise_ratio
    v, a, delta = limits.velocity_mm_per_s, limits.acceleration_mm_per_s2, limits.delta
    configured = (
        *(v, a, limits.square_corner_velocity_mm_per_s, limits.minimum_cruise_ratio),
        *(limits.z_velocity_mm_per_s or v, limits.z_acceleration_mm_per_s2 or a),
        *(v * EXTRUSION_RATIO, limits.extruder_acceleration_mm_per_s2 or a * EXTRUSION_RATIO),
        tuple((delta.radius_of_ratio(most) ** 2 if delta else math.inf, share) for most, share in SLOW_RATIOS),
    )
    return Bounds(*_bounds(moves.start, moves.end, moves.speed, lines, by_file, configured))


@kernel
def _bounds(
    start: FloatArray,
    end: FloatArray,
    speed: FloatArray,
    lines: Lines,
    set_by_the_file: tuple[FloatArray, ...],
    configured: _Numbers,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute the columns of `Bounds`.

    set_by_the_file : velocity, acceleration, corner and cruise ratio, (n,) each
    configured : the same where the file says nothing, and nowhere more speed and acceleration; those of Z and of the
        filament; and beyond which radius squared, mm², which share of speed and acceleration
    """
    n, direction, travels = len(speed), lines.direction, lines.travels
    top, acceleration, smooth, deviation = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    velocities, accelerations, corners, ratios = set_by_the_file
    velocity, limit, usual_corner, usual_ratio, z_velocity, z_limit, e_velocity, e_limit, slow_zones = configured
    for i in range(n):
        set_velocity = _or_default(velocities[i], velocity)
        set_acceleration = _or_default(accelerations[i], limit)
        v, a = speed[i], np.inf
        if travels[i]:
            v, a = min(v, set_velocity), set_acceleration
        along_z = abs(direction[i, 2])
        if along_z > 0.0:
            v, a = _share_bound(v, a, along_z, z_velocity, z_limit)
        if travels[i]:
            # NOTE: a share of the *configured* limits; what the file sets (SET_VELOCITY_LIMIT, M204) does not count
            farthest = max(start[i, 0] ** 2 + start[i, 1] ** 2, end[i, 0] ** 2 + end[i, 1] ** 2)
            share = np.inf
            for beyond, slow in slow_zones:
                if farthest > beyond:
                    share = slow
            v, a = min(v, velocity * share), min(a, limit * share)
        # the extruder leads where nothing moves in XY, and in a retraction
        filament = direction[i, 3]
        if filament < 0.0 or (filament > 0.0 and direction[i, 0] == 0.0 and direction[i, 1] == 0.0):
            v, a = _share_bound(v, a, abs(filament), e_velocity, e_limit)
        corner = _or_default(corners[i], usual_corner)
        top[i], acceleration[i] = v, a
        smooth[i] = min(a, set_acceleration * (1.0 - _or_default(ratios[i], usual_ratio)))
        deviation[i] = corner * corner * (math.sqrt(2.0) - 1.0) / set_acceleration
    return top, acceleration, smooth, deviation


@kernel
def _or_default(value: float, default: float) -> float:
    return default if np.isnan(value) else value


@kernel
def _share_bound(
    speed: float, acceleration: float, share: float, most_speed: float, most_acceleration: float
) -> tuple[float, float]:
    """Limits along the path such that the given share of it stays within those of an axis."""
    path_per_share = 1.0 / share
    return min(speed, most_speed * path_per_share), min(acceleration, most_acceleration * path_per_share)


def planner_limits(machine: Machine) -> PlannerLimits:
    """Return the limits of the printer's own configuration, as the machine file states it."""
    limits, zones = machine.limits, machine.kinematics.slow_zones
    half_step = 0.5 / float(np.max(machine.steps.per_motor))
    return PlannerLimits(
        velocity_mm_per_s=limits.velocity_mm_per_s,
        acceleration_mm_per_s2=limits.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=limits.square_corner_velocity_mm_per_s,
        z_velocity_mm_per_s=limits.z_velocity_mm_per_s,
        z_acceleration_mm_per_s2=limits.z_acceleration_mm_per_s2,
        delta=None if zones is None else DeltaSlowZones(*zones, half_step),
    )
