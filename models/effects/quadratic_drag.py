"""Declare a drag that grows with the square of the speed."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="quadratic_drag",
    title="Drag that grows with the speed's square",
    kind="force",
    physics="Air, oil or coolant that is pushed aside resists with the square of the speed.",
    equation="F = d q̇ |q̇|",
    parameters=(Parameter("force_n_s2_per_m2", "N s²/m²", "d", (-1e7, 1e7), (-100, 1000), 20.0),),
    in_data="Fast moves take more force than friction in proportion to the speed explains.",
    confounded_with={"guide_damping": "Two speeds: viscous friction is in proportion to them."},
    of=("axis",),
)
