"""Declare belts whose stiffness differs from the machine file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.arrays import FloatArray
from models.effects.effect import AT_DRIVE, Effect, Parameter
from models.machine import Machine


def fold(machine: Machine, values: Mapping[str, FloatArray]) -> Machine:
    """Scale the belts' stiffness."""
    vibration = machine.vibration.with_belts(values["relative_change"], machine.kinematics.motors)
    return replace(machine, vibration=vibration)


EFFECT = Effect(
    name="belt_stiffness",
    title="Belts tighter or slacker than the file says",
    kind="parameter",
    physics="Tension, wear and temperature change how much a belt gives way.",
    equation="k → k (1 + r)",
    parameters=(
        Parameter("relative_change", "", "r, of belt stiffness", (-0.9, 10), (-0.3, 0.3), 0.02, size="per_tower"),
    ),
    in_data="Resonances shift together; with one tower's belt, those that move this tower.",
    confounded_with={
        "effector_mass": "Two places on the bed: mass shifts the modes in other proportions.",
        "belt_position_stiffness": "Two heights: only there the shift depends on the carriage's height.",
        "torque_angle": "Two amplitudes: a belt's stiffness is the same for both.",
    },
    fold=fold,
    of_axis=(AT_DRIVE,),
    of=("carriages", "axes", "axis"),
)
