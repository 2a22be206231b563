"""Declare a belt whose stiffness depends on its stretch."""

from __future__ import annotations

from models.effects.effect import AT_DRIVE, Effect, Parameter

EFFECT = Effect(
    name="belt_hardening",
    title="Belts that harden or soften as they stretch",
    kind="force",
    physics="Teeth settle and fibres straighten: the belt's force is not quite in proportion to its stretch.",
    equation="F = k s + k₃ s³ + k₅ s⁵, s = u − q; constant beyond its peak, if it has one",
    parameters=(
        Parameter(
            "cubic_n_per_m3",
            "N/m³",
            "k₃; negative softens",
            (-1e15, 1e15),
            (-5e11, 2e12),
            1e11,
            size="per_tower",
            on_printers=(0.0, 1e15),  # what softens there to the same third order is a motor's sine
        ),
        Parameter(
            "quintic_n_per_m5", "N/m⁵", "k₅", (-1e24, 1e24), (-1e18, 2e18), 1e17, "per_tower", "shape", default=0.0
        ),
    ),
    in_data=(
        "Resonances shift with amplitude; a sine answers with harmonics: the third, and, as the weight has stretched "
        "the belts already, the second."
    ),
    confounded_with={
        "torque_angle": "Its cubic part is the same, k₃ = −k/(6a²); only a larger stretch separates the two.",
        "belt_stiffness": "Two amplitudes: only here the stiffness depends on them.",
    },
    of_axis=(AT_DRIVE,),
    of=("carriages", "axes", "axis"),
)
