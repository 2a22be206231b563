"""Declare a force that repeats along the axis."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="cogging_force",
    title="A force that repeats along the axis",
    kind="force",
    physics="Magnets of a linear motor, balls of a screw or teeth of a rack pull to and fro, once a pitch.",
    equation="F = s sin(2π q/p) + c cos(2π q/p)",
    parameters=(
        Parameter("sine_n", "N", "s", (-1e5, 1e5), (-5, 5), 0.5),
        Parameter("cosine_n", "N", "c", (-1e5, 1e5), (-5, 5), 0.5),
        Parameter("pitch_mm", "mm", "p", (0.01, 1000), (1, 50), 0.5, role="shape"),
    ),
    in_data="The force needed at constant speed repeats with the place, whatever the speed.",
    confounded_with={"ground_spring": "More than one pitch of travel: a spring does not come back."},
    of=("axis",),
)
