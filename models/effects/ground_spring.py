"""Declare a spring that holds a free axis at a place."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="ground_spring",
    title="A spring that pulls the axis to one place",
    kind="force",
    physics="Hoses, cables, a bellows or gravity on a curved guide pull harder the farther the axis goes.",
    equation="F = k q",
    parameters=(Parameter("stiffness_n_per_m", "N/m", "k", (-1e9, 1e9), (-100, 1000), 5.0),),
    in_data="The force at rest grows along the axis.",
    confounded_with={"cogging_force": "The whole travel: a ripple comes back, a spring does not."},
    of=("axis",),
)
