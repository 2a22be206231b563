"""Declare additional mass on the nozzle holder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.arrays import FloatArray
from models.delta_machine import delta_vibration, with_parts
from models.effects.effect import Effect, Parameter
from models.machine import Machine


def fold(machine: Machine, values: Mapping[str, FloatArray]) -> Machine:
    """Add the mass to the nozzle holder."""
    effector = delta_vibration(machine).effector
    heavier = replace(effector, nozzle_mass_kg=effector.nozzle_mass_kg + float(values["added_kg"]))
    return with_parts(machine, effector=heavier)


EFFECT = Effect(
    name="effector_mass",
    title="More on the nozzle holder",
    kind="parameter",
    physics="A fan, a duct, a probe or a bundle of cables moves along with the nozzle holder.",
    equation="m₁ → m₁ + Δm",
    parameters=(Parameter("added_kg", "kg", "Δm", (-1, 10), (-0.1, 0.3), 0.01),),
    in_data="Lower resonances, all towers alike; the belts sag a little more.",
    confounded_with={
        "arm_inertia": "Up and down at the centre: there only mass on the holder changes the resonance.",
        "belt_stiffness": "Two places on the bed: stiffness shifts all modes in one proportion, mass does not.",
        "effector.extruder_mass_kg": "The mode of the extruder on its mount: mass on the holder lifts it.",
    },
    fold=fold,
    of=("carriages",),
)
