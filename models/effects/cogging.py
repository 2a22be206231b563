"""Declare a motor whose position has a ripple over its step cycle."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="cogging",
    title="Motors that ripple once per step cycle",
    kind="command",
    physics="The rotor's equilibrium between full steps is not where an even current split would put it.",
    equation="u → u + a (sin θ + s₂ sin 2θ + c₂ cos 2θ),  θ = 2π u_d / p + φ",
    parameters=(
        Parameter("amplitude_mm", "mm", "a", (0, 1), (0.002, 0.05), 0.005, size="per_tower"),
        Parameter(
            "pitch_mm",
            "mm",
            "p: command from ripple to ripple, as a rule one or four full steps",
            (0.01, 50),
            (0.1, 1),
            0.01,
            size="per_tower",
            role="shape",
        ),
        Parameter(
            "phase_deg",
            "deg",
            "φ: where in its cycle a motor stands at height zero",
            (-360, 360),
            (-180, 180),
            5.0,
            size="per_tower",
            role="shape",
            default=0.0,
            starts=(0.0, 90.0, 180.0, -90.0),
        ),
        Parameter(
            "second_sine",
            "",
            "s₂: of a half of the pitch",
            (-2, 2),
            (-0.3, 0.3),
            0.02,
            "per_tower",
            "shape",
            default=0.0,
        ),
        Parameter("second_cosine", "", "c₂", (-2, 2), (-0.3, 0.3), 0.02, "per_tower", "shape", default=0.0),
    ),
    in_data="A line at speed/p that moves with the speed; stripes on the print at a fixed pitch.",
    confounded_with={
        "belt_stiffness": "Moves at several speeds: a resonance stays where it is, ripple moves with the speed."
    },
    of=("carriages", "axes", "axis"),
)
