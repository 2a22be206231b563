"""Declare a belt whose stiffness depends on the carriage's position."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="belt_position_stiffness",
    title="Belts softer the longer their free length",
    kind="force",
    physics="The free length of the belt between motor and carriage changes as the carriage travels.",
    equation="k(q) = k / (1 − r (q − q_c)), 4 k at most",
    parameters=(
        Parameter("slope_per_m", "1/m", "r", (-5, 5), (-1, 1), 0.05, size="per_tower"),
        Parameter(
            "q_centre_mm",
            "mm",
            "q_c: the height at which the file's k holds",
            (-1000, 10000),
            (100, 800),
            10.0,
            size="per_tower",
            role="shape",
        ),
    ),
    in_data="Resonances differ between low and high prints at the same place over the bed.",
    confounded_with={"belt_stiffness": "Two heights: a constant change does not depend on them."},
)
