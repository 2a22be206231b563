"""Declare backlash between motor and carriage."""

from __future__ import annotations

from models.effects.effect import AT_DRIVE, Effect, Parameter

EFFECT = Effect(
    name="belt_backlash",
    title="Play between motor and carriage",
    kind="force",
    physics="A loose pulley or tooth moves freely through a dead band; spring and damper of the belt act outside it.",
    equation="F = k (s − w/2 sgn s) + c ṡ for |s| > w/2, else 0",
    parameters=(
        Parameter("width_mm", "mm", "w: the full dead band", (0, 5), (0.01, 0.2), 0.02, size="per_tower"),
        Parameter(
            "landing_s_per_m",
            "s/m",
            "λ: how the flanks damp what lands on them (Hunt & Crossley, 1975)",
            (0, 100),
            (0, 0.5),
            0.05,
            size="per_tower",
            role="shape",
            default=0.0,
        ),
    ),
    in_data=(
        "Knocks when the belt's force changes sign. A vertical belt always carries the weight: play shows only where "
        "the motion pushes harder than gravity pulls."
    ),
    confounded_with={
        "coulomb_friction": "Friction acts whenever a carriage turns back, play only when the belt's force does.",
        "torque_angle": "Slack softens small forces, a motor's torque softens large ones.",
    },
    of_axis=(AT_DRIVE,),
    of=("carriages", "axes", "axis"),
)
