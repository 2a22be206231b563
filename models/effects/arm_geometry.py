"""Declare arms and towers whose sizes differ from the machine file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.arrays import FloatArray
from models.effects.effect import Effect, Parameter
from models.machine import Machine


def fold(machine: Machine, values: Mapping[str, FloatArray]) -> Machine:
    """Add the deviations to arm lengths and delta radii."""
    """Change the arms' lengths and the towers' radii of the true geometry."""
    true = machine.kinematics.recalibrated(values["arm_length_mm"], values["delta_radius_mm"])
    return replace(machine, kinematics=true or machine.kinematics)


EFFECT = Effect(
    name="arm_geometry",
    title="Arms and towers off their nominal sizes",
    kind="parameter",
    physics="The carriages are commanded by the nominal geometry and move the nozzle by the true one.",
    equation="L → L + ΔL, R → R + ΔR",
    parameters=(
        Parameter("arm_length_mm", "mm", "ΔL", (-50, 50), (-2, 2), 0.2, size="per_tower"),
        Parameter("delta_radius_mm", "mm", "ΔR", (-50, 50), (-2, 2), 0.2, size="per_tower"),
    ),
    in_data="Wrong sizes and a bowed first layer; accelerations change by parts in a thousand.",
    confounded_with={"sensor_misalignment": "A measured print, not accelerations: they can hardly tell the two."},
    fold=fold,
    of=("carriages",),
)
