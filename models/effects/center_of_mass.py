"""Declare an effector whose centre of mass differs from the machine file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.arrays import FloatArray, constant
from models.delta_machine import delta_vibration, with_parts
from models.effects.effect import Effect, Parameter
from models.machine import Machine


def fold(machine: Machine, values: Mapping[str, FloatArray]) -> Machine:
    """Move the effector's centre of mass."""
    effector = delta_vibration(machine).effector
    moved = constant(effector.center_of_mass_mm + values["offset_mm"])
    return with_parts(machine, effector=replace(effector, center_of_mass_mm=moved))


EFFECT = Effect(
    name="center_of_mass",
    title="An effector heavier on one side",
    kind="parameter",
    physics=(
        "A mass off the middle loads the rods unevenly. Ideal rods carry that among themselves, so by virtual work the "
        "carriages do not feel it; by the map of Eqs. 22-27 they do."
    ),
    equation="δ → δ + Δδ   (Eq. 20)",
    parameters=(Parameter("offset_mm", "mm", "Δδ, along x, y, z", (-200, 200), (-20, 20), 1.0, size="vector3"),),
    in_data="With force_map 'paper': towers differ. With 'virtual_work': nothing at all.",
    confounded_with={"force_map": "Which tower is off: a change of map shows on a centred mass too."},
    fold=fold,
    of=("carriages",),
)
