"""Declare friction that is a spring before it slides."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="bristle_friction",
    title="Friction that gives like a spring before it slides",
    kind="force",
    physics="Contacts bend as bristles do before they slide, and what is bent remembers: hysteresis.",
    equation="F = F_C z,  ż = (q̇ − |q̇| z)/s₀   (Dahl, 1968)",
    parameters=(
        Parameter("force_n", "N", "F_C: once it slides", (0, 1e5), (0.5, 10), 0.5),
        Parameter("presliding_mm", "mm", "s₀: way in which it bends", (1e-6, 1000), (0.001, 0.1), 0.005, role="shape"),
    ),
    in_data="Small motions return on another path than they went; large ones look like dry friction.",
    confounded_with={
        "coulomb_friction": "Small motions: only bristles spring back.",
        "belt_backlash": "The size of motion: play has a width of its own, bristles bend at any.",
    },
    of=("axis",),
)
