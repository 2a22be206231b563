"""A motor whose position ripples with its step cycle."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="cogging",
    title="Motors that ripple once per step cycle",
    kind="command",
    physics="The rotor's equilibrium between full steps is not where an even current split would put it.",
    equation="u → u + a sin(2π u_d / p)",
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
    ),
    in_data="A line at speed/p that moves with the speed; stripes on the print at a fixed pitch.",
    rivals={"belt_stiffness": "Moves at several speeds: a resonance stays where it is, ripple moves with the speed."},
)
