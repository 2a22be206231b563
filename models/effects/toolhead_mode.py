"""Declare a toolhead whose mode depends on where it is along X."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="toolhead_mode",
    title="A toolhead whose mode depends on where it is along X",
    kind="force",
    physics=(
        "The beam that carries the toolhead gives way more in its middle than at its ends, and twists more the "
        "farther from a guide. Of an axis with several modes this is that of the highest frequency."
    ),
    equation="ω² → ω² (1 + r (x − x_c) + h (x − x_c)²)",
    parameters=(
        Parameter("slope_per_m", "1/m", "r, of ω² of the axis' highest mode", (-10, 10), (-2, 2), 0.05, "per_tower"),
        Parameter("curve_per_m2", "1/m²", "h", (-200, 200), (-20, 20), 0.5, "per_tower"),
        Parameter(
            "x_centre_mm", "mm", "x_c: where the file's ω holds", (-1000, 1000), (0, 300), 5.0, "scalar", "shape"
        ),
    ),
    in_data="Shaken at several x, along x or y, a resonance is found at another frequency each time.",
    confounded_with={
        "belt_position_stiffness": "Shake y at several x: the belts of y do not know where x is.",
        "gantry_racking": "The middle of the gantry: racking comes from both sides of it, and turns its sign there.",
    },
    of=("axes",),
    spread_mm=(40.0, 0.0, 0.0),
)
