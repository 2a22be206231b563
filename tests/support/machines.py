"""Machines that many tests share."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from models.arrays import constant
from models.file import load_machine
from models.machine import Machine
from validation import kalico


@cache
def machine() -> Machine:
    """Return the delta of the paper."""
    return load_machine("mp-delta-pro")


def host_machine() -> Machine:
    """Return it with the geometry of the host's delta."""
    geometry = replace(
        machine().kinematics,
        arm_lengths_mm=constant([kalico.ARM_LENGTH_MM] * 3),
        delta_radii_mm=constant([kalico.RADIUS_MM] * 3),
        tower_angles_deg=constant([210.0, 330.0, 90.0]),
        effector_height_mm=0.0,
    )
    return replace(machine(), kinematics=geometry)
