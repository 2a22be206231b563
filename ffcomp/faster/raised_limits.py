"""Moves as fast as the limits of machine, nozzle and filament allow, whatever the slicer says."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffcomp.faster.bound import Bound
from ffcomp.planner.limits import PlannerLimits, lines_of
from gcode.layers import Labels
from gcode.program import Moves
from gcode.slicing import some
from models.arrays import BoolArray, FloatArray
from models.machine import Machine

PROBE_STEP_MM = 0.01
PATH_SHARE = 0.9  # of the carriages' limits, that a path may use: the command needs more than its path
CORNER_VELOCITY_PER_UM = 2.4  # mm/s of square corner velocity for each µm of the bound,
CORNER_VELOCITY_RANGE = (5.0, 60.0)  # at least and at most


@dataclass(frozen=True, slots=True)
class RaisedLimits:
    """n moves with their highest limits, and which of them keep the slicer's."""

    moves: Moves
    kept: BoolArray  # (n,)
    bound_mm: FloatArray  # (n,)
    at_flow: BoolArray  # (n,) the nozzle's flow is what their speed is limited by

    def part(self, part: slice) -> RaisedLimits:
        """Return some of the moves."""
        return RaisedLimits(some(self.moves, part), self.kept[part], self.bound_mm[part], self.at_flow[part])


def raised_limits(
    moves: Moves, labels: Labels, kept: BoolArray, bound: Bound, machine: Machine, limits: PlannerLimits
) -> RaisedLimits:
    """Open the limits of all moves that need not keep the slicer's motion.

    kept : (n,) those that keep it whatever they are
    """
    lines, errors_mm = lines_of(moves), bound.errors_mm(labels)
    filament = lines.direction[:, 3]
    kept = kept | bound.keeps(labels) | ~lines.travels | (filament < 0.0)
    # how far the carriage that goes farthest goes for a mm of each move, at the worse of its ends
    gain = np.max(_carriage_gains(moves, lines.direction[:, :3], machine), axis=0)
    fastest = bound.max_speed_mm_per_s or limits.velocity_mm_per_s
    velocity = float(np.min(machine.limits.carriage_velocity_mm_per_s))
    speed = np.minimum(fastest, PATH_SHARE * velocity / gain)
    flowing = lines.travels & (filament > 0.0)
    by_flow = np.full(len(moves), np.inf)
    by_flow[flowing] = _flow(moves, filament, flowing, bound, limits) / filament[flowing]
    at_flow = by_flow < speed
    speed = np.minimum(speed, by_flow)
    corner = np.clip(CORNER_VELOCITY_PER_UM * 1e3 * errors_mm, *CORNER_VELOCITY_RANGE)
    quickest = replace(
        moves,
        speed=np.where(flowing, speed, np.maximum(speed, moves.speed)),
        velocity_limit=np.full(len(moves), fastest),
        acceleration=PATH_SHARE * machine.limits.carriage_acceleration_mm_per_s2 / gain,
        square_corner_velocity=corner,
        minimum_cruise_ratio=np.zeros(len(moves)),
    )
    return RaisedLimits(selected_limits(quickest, moves, ~kept), kept, errors_mm, at_flow & ~kept)


def selected_limits(ones: Moves, others: Moves, which: BoolArray) -> Moves:
    """Return the others' limits, but those of the ones where `which` says so, (n,)."""
    names = ("speed", "velocity_limit", "acceleration", "square_corner_velocity", "minimum_cruise_ratio")
    return replace(others, **{name: np.where(which, getattr(ones, name), getattr(others, name)) for name in names})


def slowed(moves: Moves, share: FloatArray, speed: FloatArray) -> Moves:
    """Scale time where the share is below one: speed v → s v, acceleration a → s² a.

    Parameters
    ----------
    share : (n,) s
    speed : (n,) mm/s that is scaled
    """
    less = share < 1.0
    return replace(
        moves,
        speed=np.where(less, speed * share, moves.speed),
        acceleration=np.where(less, moves.acceleration * share**2, moves.acceleration),
        square_corner_velocity=np.where(less, moves.square_corner_velocity * share, moves.square_corner_velocity),
    )


def _flow(moves: Moves, filament: FloatArray, flowing: BoolArray, bound: Bound, limits: PlannerLimits) -> float:
    """Return how fast the filament may go, mm/s."""
    if bound.max_flow_mm3_per_s is not None:
        return bound.max_flow_mm3_per_s / (0.25 * np.pi * limits.filament_diameter_mm**2)
    return float((moves.speed * filament)[flowing].max(initial=0.0))


def least_carriage_gain(moves: Moves, machine: Machine) -> FloatArray:
    """Return how far the farthest carriage goes for a mm of each move, (n,), where that is least of three places."""
    direction = lines_of(moves).direction[:, :3]
    middle = 0.5 * (moves.start + moves.end)[:, :3]
    return np.asarray(np.min(_carriage_gains(moves, direction, machine, middle), axis=0))


def _carriage_gains(moves: Moves, direction: FloatArray, machine: Machine, *more: FloatArray) -> list[FloatArray]:
    carriages = machine.kinematics.compiled().inverse
    places = (moves.start[:, :3], moves.end[:, :3] - PROBE_STEP_MM * direction, *more)
    rates = (
        np.abs(carriages(np.ascontiguousarray(at + PROBE_STEP_MM * direction)) - carriages(np.ascontiguousarray(at)))
        for at in places
    )
    return [np.maximum(np.max(rate, axis=1) / PROBE_STEP_MM, 0.5) for rate in rates]
