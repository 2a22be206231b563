"""Declare a vibrating frame."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="frame_mode",
    title="A frame that sways under the moving effector",
    kind="frame",
    physics=(
        "The reaction to the effector's acceleration pushes the frame with towers, carriages and bed, which stands on "
        "a soft base. Accelerometers feel the sway; the print, made on a bed that sways along, feels what it does to "
        "the arms."
    ),
    equation="M_f (d̈ + 2 ζ ω ḋ + ω² d) = −F,  F = force of the arms on the effector along d",
    parameters=(
        Parameter("mass_kg", "kg", "M_f: all that sways, without the effector", (0.1, 1e4), (3, 100), 50.0, power=-1),
        Parameter("frequency_hz", "Hz", "ω/2π, with the effector off", (0.5, 500), (5, 60), 1.0, role="shape"),
        Parameter("damping_ratio", "", "ζ", (0, 2), (0.01, 0.1), 0.01, role="shape"),
        Parameter(
            "direction", "", "'x', 'y', 'both' alike, or a unit vector", (-1, 1), (-1, 1), 0.1, "direction", "shape"
        ),
    ),
    in_data="A pair of peak and dip in one horizontal direction, at the same frequency all over the bed.",
    confounded_with={
        "extruder_mount": "The carriages: a frame shakes the effector whole, the mount only the extruder."
    },
)
