"""Declare friction in the guides that is larger at rest than in motion."""

from __future__ import annotations

from models.effects.dry import PRESLIDING, reversal_parameters
from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="stribeck_friction",
    title="Sticking guides: dry friction with a surplus at rest",
    kind="force",
    physics="Grease and seals stick at rest; the surplus over dry friction fades as the lubricant is drawn in.",
    equation="F = (F_C + F_extra exp(−|q̇/v_s|^δ)) sgn(q̇)   (Armstrong-Hélouvry, Dupont & Canudas de Wit, 1994)",
    parameters=(
        Parameter("force_n", "N", "friction at speed", (0, 200), (0.5, 10), 0.5, size="per_tower"),
        Parameter("extra_force_n", "N", "surplus at rest", (0, 200), (0.2, 5), 0.5, size="per_tower"),
        Parameter(
            "velocity_mm_per_s",
            "mm/s",
            "speed at which a third of the surplus is left",
            (0.1, 500),
            (2, 50),
            2.0,
            size="per_tower",
            role="shape",
        ),
        Parameter(
            "exponent", "", "δ: how suddenly it fades", (0.3, 6), (0.5, 2), 0.1, "per_tower", "shape", default=2.0
        ),
        *reversal_parameters("per_tower"),
    ),
    in_data="As dry friction, with a spike at each start; very slow moves go in jerks.",
    confounded_with={"coulomb_friction": "Moves slower than v_s: only here the friction rises towards rest."},
    of=("carriages", "axes", "axis"),
    of_printers=(PRESLIDING,),
)
