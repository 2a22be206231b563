"""Declare an extruder mount whose stiffness and damping differ from the machine file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.arrays import FloatArray, constant
from models.delta_machine import delta_vibration, with_parts
from models.effects.effect import Effect, Parameter
from models.machine import Machine


def fold(machine: Machine, values: Mapping[str, FloatArray]) -> Machine:
    """Scale the mount's stiffness and damping."""
    effector = delta_vibration(machine).effector
    mount = replace(
        effector,
        extruder_stiffness_n_per_m=constant(
            effector.extruder_stiffness_n_per_m * (1 + values["relative_stiffness_change"])
        ),
        extruder_damping_n_s_per_m=constant(
            effector.extruder_damping_n_s_per_m * (1 + values["relative_damping_change"])
        ),
    )
    return with_parts(machine, effector=mount)


EFFECT = Effect(
    name="extruder_mount",
    title="The extruder's mount, loose or stiff",
    kind="parameter",
    physics="Screws and printed brackets hold the extruder; they loosen, or are tightened.",
    equation="K → K (1 + r_k), B → B (1 + r_b), per axis",
    parameters=(
        Parameter("relative_stiffness_change", "", "r_k, of x, y, z", (-0.95, 20), (-0.5, 0.5), 0.02, size="vector3"),
        Parameter("relative_damping_change", "", "r_b, of x, y, z", (-1, 50), (-0.5, 1), 0.05, size="vector3"),
    ),
    in_data="The resonance of one axis of the nozzle shifts or broadens; the carriages hardly notice.",
    confounded_with={
        "effector.extruder_mass_kg": "The antiresonance and the mode together: mass shifts both, stiffness one."
    },
    fold=fold,
    of=("carriages",),
)
