"""Declare accelerometers with gain errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.arrays import FloatArray
from models.effects.effect import Effect, Parameter, Signals


def measure(true: Signals, values: Mapping[str, FloatArray]) -> Signals:
    """Scale every channel."""
    carriage = true.carriage * (1 + values["carriage_relative_change"])
    return replace(true, carriage=carriage, nozzle=true.nozzle * (1 + values["nozzle_relative_change"]))


EFFECT = Effect(
    name="sensor_gain",
    title="Accelerometers that read too much or too little",
    kind="sensor",
    physics="Sensitivities are calibrated to a few percent.",
    equation="a → (1 + g) a, per channel",
    parameters=(
        Parameter("carriage_relative_change", "", "g of A, B, C", (-0.9, 9), (-0.1, 0.1), 0.02, size="per_tower"),
        Parameter("nozzle_relative_change", "", "g of x, y, z", (-0.9, 9), (-0.1, 0.1), 0.02, size="vector3"),
    ),
    in_data="One channel too large or too small by one factor at all frequencies and places.",
    confounded_with={"effector_mass": "Frequencies: a gain shifts none."},
    measure=measure,
    of=("carriages", "axes", "axis"),
)
