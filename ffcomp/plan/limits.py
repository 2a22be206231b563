"""What the firmware allows each move by itself: its top speed and its acceleration.

The rules are those of Klipper's and Kalico's planner (checked against the running host in the tests). Units:
mm, s, mm/s, mm/s²; a limit that does not apply is infinite.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gcode.program import Moves

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SHORTEST_TRAVEL_MM = 1e-9  # what moves the nozzle less than this counts as extruder-only
SLOW_RATIOS = ((3.0, 0.5), (6.0, 0.25))  # beyond this carriage speed / nozzle speed, this share is allowed


class DeltaReach(NamedTuple):
    """The geometry that decides where a delta's firmware slows down."""

    radius_mm: float
    arm_length_mm: float  # the shortest arm
    half_step_mm: float  # half the carriage travel of one step, the smallest of the three

    def radius_of_ratio(self, ratio: float) -> float:
        """Distance from the centre where a carriage can be asked for `ratio` times the nozzle's speed, mm.

        A carriage stands sqrt(L² - rho²) above the lower joint of an arm that leans out by rho. The chord of
        slope `ratio` over one step in rho has its centre at ratio sqrt(L²/(ratio² + 1) - half²), its far end
        half a step further.
        """
        lean = ratio * math.sqrt(self.arm_length_mm**2 / (ratio**2 + 1.0) - self.half_step_mm**2)
        return lean + self.half_step_mm - self.radius_mm


@dataclass(frozen=True, slots=True)
class FirmwareLimits:
    """The limits in the firmware's configuration; those in the file come with the moves."""

    velocity_mm_per_s: float
    acceleration_mm_per_s2: float
    square_corner_velocity_mm_per_s: float = 5.0
    minimum_cruise_ratio: float = 0.5
    z_velocity_mm_per_s: float | None = None  # None: as the nozzle
    z_acceleration_mm_per_s2: float | None = None  # None: as the nozzle
    extruder_velocity_mm_per_s: float | None = None  # None: velocity times `extrusion_ratio`
    extruder_acceleration_mm_per_s2: float | None = None  # None: acceleration times `extrusion_ratio`
    instantaneous_corner_velocity_mm_per_s: float = 1.0  # step in the speed of the filament at a corner
    nozzle_diameter_mm: float = 0.4
    filament_diameter_mm: float = 1.75
    delta: DeltaReach | None = None  # None: no slow zones

    def __post_init__(self) -> None:
        complaints = [_complaint(field.name, getattr(self, field.name)) for field in fields(self)]
        if any(complaints):
            raise ValueError(" ".join(filter(None, complaints)))

    @property
    def extrusion_ratio(self) -> float:
        """Filament per path in the thickest line expected: four nozzle squares over the filament's area."""
        return 16.0 * self.nozzle_diameter_mm**2 / (math.pi * self.filament_diameter_mm**2)


def _complaint(name: str, value: float | None) -> str:
    """What is wrong with a firmware limit; empty if nothing is."""
    if value is None or name == "delta":
        return ""
    if name == "minimum_cruise_ratio":
        allowed, rule = 0.0 <= value < 1.0, "at least zero and below one"
    elif name.endswith("corner_velocity_mm_per_s"):
        allowed, rule = value >= 0.0, "zero or more"
    else:
        allowed, rule = value > 0.0, "above zero"
    return "" if allowed else f"The firmware limit {name} is {value:g}; it must be {rule}."


@dataclass(frozen=True, slots=True)
class Lines:
    """n straight moves as geometry."""

    step: FloatArray  # (n, 4) mm, columns X Y Z E: end - start; XYZ zero where the move is extruder-only
    length: FloatArray  # (n,) mm of path; of filament where the move is extruder-only
    direction: FloatArray  # (n, 4) step / length; zero for moves that go nowhere
    travels: BoolArray  # (n,) the nozzle moves


@dataclass(frozen=True, slots=True)
class Bounds:
    """What each of n moves may do by itself."""

    speed: FloatArray  # (n,) mm/s
    acceleration: FloatArray  # (n,) mm/s²
    smooth_acceleration: FloatArray  # (n,) mm/s², for the pass that keeps a minimum of cruising
    junction_deviation: FloatArray  # (n,) mm, how far a corner may be cut: what makes a square corner's speed


def lines_of(moves: Moves) -> Lines:
    """The geometry of the moves, extruder-only ones recognised."""
    step = moves.end - moves.start
    travel = np.sqrt(step[:, 0] ** 2 + step[:, 1] ** 2 + step[:, 2] ** 2)
    travels = travel >= SHORTEST_TRAVEL_MM
    step[~travels, :3] = 0.0
    length = np.where(travels, travel, np.abs(step[:, 3]))
    per_mm = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    return Lines(step, length, step * per_mm[:, None], travels)


def bounds_of(moves: Moves, lines: Lines, limits: FirmwareLimits) -> Bounds:
    """Every limit on single moves, put together."""
    set_velocity = _or_default(moves.velocity_limit, limits.velocity_mm_per_s)
    set_acceleration = _or_default(moves.acceleration, limits.acceleration_mm_per_s2)
    speed = np.where(lines.travels, np.minimum(moves.speed, set_velocity), moves.speed)
    acceleration = np.where(lines.travels, set_acceleration, np.inf)
    more = (_z_bound(lines, limits), _reach_bound(moves, lines, limits), _extruder_bound(lines, limits))
    for top_speed, top_acceleration in more:
        speed, acceleration = np.minimum(speed, top_speed), np.minimum(acceleration, top_acceleration)
    cruise_ratio = _or_default(moves.minimum_cruise_ratio, limits.minimum_cruise_ratio)
    smooth = np.minimum(acceleration, set_acceleration * (1.0 - cruise_ratio))
    corner = _or_default(moves.square_corner_velocity, limits.square_corner_velocity_mm_per_s)
    return Bounds(speed, acceleration, smooth, corner**2 * (math.sqrt(2.0) - 1.0) / set_acceleration)


def _or_default(value: FloatArray, default: float) -> FloatArray:
    return np.where(np.isnan(value), default, value)


def _z_bound(lines: Lines, limits: FirmwareLimits) -> tuple[FloatArray, FloatArray]:
    """The Z part of a move within Z's own limits."""
    velocity = limits.z_velocity_mm_per_s or limits.velocity_mm_per_s
    acceleration = limits.z_acceleration_mm_per_s2 or limits.acceleration_mm_per_s2
    return _share_bound(lines.direction[:, 2], velocity, acceleration)


def _extruder_bound(lines: Lines, limits: FirmwareLimits) -> tuple[FloatArray, FloatArray]:
    """The extruder within its own limits, where it leads: no motion in XY, or a retraction."""
    ratio = limits.extrusion_ratio
    velocity = limits.extruder_velocity_mm_per_s or limits.velocity_mm_per_s * ratio
    acceleration = limits.extruder_acceleration_mm_per_s2 or limits.acceleration_mm_per_s2 * ratio
    share = lines.direction[:, 3]
    still = (lines.step[:, 0] == 0.0) & (lines.step[:, 1] == 0.0)
    return _share_bound(np.where(still | (share < 0.0), share, 0.0), velocity, acceleration)


def _share_bound(share: FloatArray, velocity: float, acceleration: float) -> tuple[FloatArray, FloatArray]:
    """Limits along the path such that the given share of it stays within `velocity` and `acceleration`."""
    path_per_share = np.divide(1.0, np.abs(share), out=np.full_like(share, np.inf), where=share != 0.0)
    return velocity * path_per_share, acceleration * path_per_share


def _reach_bound(moves: Moves, lines: Lines, limits: FirmwareLimits) -> tuple[FloatArray, FloatArray]:
    """A delta slows down at large radius, where the carriages move faster than the nozzle.

    NOTE: a share of the *configured* limits; what the file sets (SET_VELOCITY_LIMIT, M204) does not count.
    """
    share = np.full(len(moves), np.inf)
    if limits.delta is not None:
        square = np.maximum((moves.start[:, :2] ** 2).sum(axis=1), (moves.end[:, :2] ** 2).sum(axis=1))
        for ratio, slow in SLOW_RATIOS:
            share[lines.travels & (square > limits.delta.radius_of_ratio(ratio) ** 2)] = slow
    return limits.velocity_mm_per_s * share, limits.acceleration_mm_per_s2 * share
