"""Read the planner's limits from a machine file."""

from __future__ import annotations

import numpy as np

from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits
from models.machine import DeltaKinematics, Machine, Steps


def planner_limits(machine: Machine) -> PlannerLimits:
    """What the printer's own configuration allows, as the machine file states it."""
    own, geometry = machine.limits, machine.kinematics
    return PlannerLimits(
        velocity_mm_per_s=own.velocity_mm_per_s,
        acceleration_mm_per_s2=own.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=own.square_corner_velocity_mm_per_s,
        z_velocity_mm_per_s=own.z_velocity_mm_per_s,
        z_acceleration_mm_per_s2=own.z_acceleration_mm_per_s2,
        delta=_slow_zones(geometry, machine.steps) if isinstance(geometry, DeltaKinematics) else None,
    )


def _slow_zones(geometry: DeltaKinematics, steps: Steps) -> DeltaSlowZones:
    """Where the firmware slows a delta down."""
    half_step = 0.5 / float(np.max(steps.per_motor))
    return DeltaSlowZones(float(geometry.delta_radii_mm.max()), float(geometry.arm_lengths_mm.min()), half_step)
