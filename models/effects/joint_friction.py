"""Declare dry friction in the ball joints."""

from __future__ import annotations

from models.effects.dry import reversal_parameters
from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="joint_friction",
    title="Dry friction of the arms' ball joints",
    kind="force",
    physics="Tight or dirty joints hold the effector back with the same force at every speed, against its direction.",
    equation="F = −f Ẋ/|Ẋ|; at rest any |F| ≤ f",
    parameters=(
        Parameter("force_n", "N", "f, on the effector", (0, 200), (0.2, 5), 0.5),
        *reversal_parameters("scalar"),
    ),
    in_data="Jumps of the nozzle's acceleration at reversals of the path, shared by all three towers.",
    confounded_with={"coulomb_friction": "One tower at a time: guide friction stays on the tower that turns back."},
    of=("carriages",),
)
