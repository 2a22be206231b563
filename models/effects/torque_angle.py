"""Declare a motor whose torque is a sine of its angle from the step."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="torque_angle",
    title="Motors near their holding torque",
    kind="force",
    physics="A stepper's torque is a sine of the angle between rotor and field: soft near its peak.",
    equation="F = k a sin θ, s = u − q = a ((1 − b) θ + b sin θ)",
    parameters=(
        Parameter(
            "amplitude_mm",
            "mm",
            "a: a quarter wave is π a / 2; four full steps are 2 π a",
            (0.01, 100),
            (0.1, 2),
            0.5,
            size="per_tower",
            power=-2,
        ),
        Parameter(
            "belt_share",
            "",
            "b: of the give between motor and carriage, what is the belt's and not the motor's",
            (0, 0.45),
            (0, 0.3),
            0.05,
            role="shape",
            default=0.0,
        ),
    ),
    in_data="Nothing at normal current; near the peak force k a, softer resonances and lost steps (slips of 2 π a).",
    confounded_with={
        "belt_hardening": "The same to third order; only a larger stretch separates the two.",
        "belt_backlash": "Small motions: play softens them, the sine does not.",
    },
)
