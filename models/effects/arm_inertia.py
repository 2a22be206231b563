"""Declare mass that lies along the arms instead of at their ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.arrays import FloatArray
from models.delta_machine import delta_vibration, with_parts
from models.effects.effect import Effect, Parameter
from models.machine import Machine


def fold(machine: Machine, values: Mapping[str, FloatArray]) -> Machine:
    """Move that share of the arms' mass from their ends to along them."""
    carriage = delta_vibration(machine).carriage
    share = carriage.arm_mass_share_at_ends - float(values["share_along"])
    return with_parts(machine, carriage=replace(carriage, arm_mass_share_at_ends=share))


EFFECT = Effect(
    name="arm_inertia",
    title="Arms whose mass lies along them",
    kind="parameter",
    physics=(
        "A file that says nothing else has half of an arm's mass at either end. Mass along the arm moves less than its "
        "ends do where these move differently: uniform rods are 1, carbon tubes with heavy ends less."
    ),
    equation="T → T − σ m_f/12 Σ |Ẋ − ẑ q̇_i|²",
    parameters=(Parameter("share_along", "", "σ: of the arms' mass, more than the file says", (-1, 1), (0, 1), 0.1),),
    in_data="Higher resonances sideways, more so near the rim; up and down at the centre nothing changes.",
    confounded_with={
        "effector_mass": "Up and down at the centre: mass on the holder slows that too, mass along the arms does not.",
        "belt_stiffness": "Up and down at the centre: there only stiffer belts lift the resonance.",
    },
    fold=fold,
    of=("carriages",),
)
