"""Declare viscous friction that is not the same in both directions."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="friction_by_direction",
    title="Viscous friction that differs by direction",
    kind="force",
    physics="A screw's preload, a cable chain or a seal's lip resists more in one direction than in the other.",
    equation="F = (b + Δb/2 sgn q̇) q̇",
    parameters=(
        Parameter("damping_difference_n_s_per_m", "N s/m", "Δb: forwards less backwards", (-1e5, 1e5), (-50, 50), 2.0),
    ),
    in_data="Forwards and backwards the same speed takes other forces, by more the faster it is.",
    confounded_with={
        "quadratic_drag": "Both directions: drag is the same in both.",
        "coulomb_friction": "Two speeds: dry friction does not grow with speed.",
    },
    of=("axis",),
)
