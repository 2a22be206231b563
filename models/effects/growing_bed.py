"""Declare a bed that grows heavier with the print."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="growing_bed",
    title="A bed that grows heavier with the print",
    kind="force",
    physics=(
        "What a bed slinger prints rides on the bed: the higher the print, the more mass the belt moves. The file's "
        "numbers are those of the empty bed. Every mode of the axis slows down alike, which is exact for one mode."
    ),
    equation="M → M (1 + g z),  z = height of the nozzle over the bed",
    parameters=(
        Parameter(
            "growth_per_m", "1/m", "g, of the mass that an axis moves", (0, 100), (0.2, 4), 0.1, size="per_tower"
        ),
    ),
    in_data="The resonance of the bed's axis falls from layer to layer, those of the other axes stay.",
    confounded_with={
        "belt_stiffness": "Two heights of one print: a slack belt is as slack at the first layer.",
    },
    of=("axes",),
    spread_mm=(0.0, 0.0, 20.0),
)
