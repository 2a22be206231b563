"""Read from a machine file what the printer's own configuration says: the planner's limits, macros, homing."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits
from models.kinematics.base import Kinematics
from models.machine import Machine, Steps
from models.pressure import CORNER_MM_PER_S


def planner_limits(machine: Machine) -> PlannerLimits:
    """Return the limits of the printer's own configuration, as the machine file states it."""
    own = machine.limits
    return PlannerLimits(
        velocity_mm_per_s=own.velocity_mm_per_s,
        acceleration_mm_per_s2=own.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=own.square_corner_velocity_mm_per_s,
        z_velocity_mm_per_s=own.z_velocity_mm_per_s,
        z_acceleration_mm_per_s2=own.z_acceleration_mm_per_s2,
        instantaneous_corner_velocity_mm_per_s=CORNER_MM_PER_S
        if machine.pressure is None
        else machine.pressure.corner_velocity_mm_per_s,
        delta=_slow_zones(machine.kinematics, machine.steps),
    )


def known_to_the_firmware(machine: Machine) -> dict[str, Any]:
    """Return what a G-code reader must know besides the file, as its keyword arguments."""
    return {"returns": machine.returns, "still": machine.still, "homed_mm": machine.home_mm}


def _slow_zones(kinematics: Kinematics, steps: Steps) -> DeltaSlowZones | None:
    """Return where the firmware slows down near the border; None: nowhere."""
    zones = kinematics.slow_zones
    half_step = 0.5 / float(np.max(steps.per_motor))
    return None if zones is None else DeltaSlowZones(zones.delta_radius_mm, zones.shortest_arm_mm, half_step)
