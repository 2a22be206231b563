"""Declare a delay of the command."""

from __future__ import annotations

from models.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="command_delay",
    title="Motors that follow their command late",
    kind="command",
    physics="Electronics, filters and step pulses take time; the motor plays the command of a moment ago.",
    equation="u_d(t) → u_d(t − τ)",
    parameters=(Parameter("delay_s", "s", "τ", (0, 0.1), (1e-4, 5e-3), 1e-4, size="per_tower"),),
    in_data="The whole answer shifts in time, the phase falls in proportion to frequency.",
    confounded_with={
        "guide_damping": "Several speeds and frequencies: damping lowers the resonance, a delay does not.",
        "sensor_time_offset": "A delay of one tower only, or position sensors on the same clock as the command.",
    },
    of=("carriages", "axes", "axis"),
)
