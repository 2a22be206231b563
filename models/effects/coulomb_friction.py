"""Declare dry friction in the guides."""

from __future__ import annotations

from models.effects.dry import PRESLIDING, reversal_parameters
from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="coulomb_friction",
    title="Dry friction of the carriages on their guides",
    kind="force",
    physics="The guide holds a carriage back with the same force at every speed, and holds it fast at rest.",
    equation="F = F_C sgn(q̇); at rest any |F| ≤ F_C",
    parameters=(
        Parameter("force_n", "N", "friction of each guideway", (0, 200), (0.5, 10), 0.5, size="per_tower"),
        *reversal_parameters("per_tower"),
    ),
    in_data="Acceleration jumps by up to 2 F_C/m when a carriage turns back; slow moves suffer as much as fast ones.",
    confounded_with={
        "stribeck_friction": "Slow moves: only Stribeck friction falls with speed.",
        "guide_damping": "Two speeds: viscous friction grows with speed, dry friction does not.",
        "belt_backlash": "Play needs the belt's force to change sign, friction the carriage's speed.",
        "joint_friction": "One tower at a time near the centre: the effector moves, two carriages rest.",
    },
    of=("carriages", "axes", "axis"),
    of_printers=(PRESLIDING,),
)
