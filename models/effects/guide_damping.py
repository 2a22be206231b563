"""Declare additional viscous friction in the guides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.arrays import FloatArray
from models.effects.effect import Effect, Parameter
from models.machine import Machine


def fold(machine: Machine, values: Mapping[str, FloatArray]) -> Machine:
    """Add the damping to the guides."""
    return replace(machine, vibration=machine.vibration.with_guide_damping(values["added_n_s_per_m"]))


EFFECT = Effect(
    name="guide_damping",
    title="Guides with more viscous friction",
    kind="parameter",
    physics="Grease shears between carriage and rail: a force in proportion to speed.",
    equation="b → b + Δb",
    parameters=(Parameter("added_n_s_per_m", "N s/m", "Δb", (-1000, 10000), (-10, 50), 1.0, size="per_tower"),),
    in_data="Lower, broader resonances, and a carriage that lags in proportion to its speed.",
    confounded_with={
        "command_delay": "Several speeds and frequencies: a delay keeps the resonance's height.",
        "coulomb_friction": "Two speeds: dry friction does not grow with speed.",
        "carriage.belt_damping_n_s_per_m": "Long moves at constant speed: the belt's damper is not stretched there.",
    },
    fold=fold,
    of=("carriages", "axes", "axis"),
)
