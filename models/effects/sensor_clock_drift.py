"""Declare a recorder whose clock runs fast or slow."""

from __future__ import annotations

from collections.abc import Mapping

from models.arrays import FloatArray
from models.effects.effect import Effect, Parameter, Signals, resampled


def measure(true: Signals, values: Mapping[str, FloatArray]) -> Signals:
    """Sample the signals by the recorder's clock."""
    return resampled(true, true.t_s / (1 + float(values["relative_drift"])))


EFFECT = Effect(
    name="sensor_clock_drift",
    title="A recorder whose clock is fast or slow",
    kind="sensor",
    physics="Accelerometers sample by their own oscillators, which are right to a percent or two.",
    equation="a(t) → a(t / (1 + ε))",
    parameters=(Parameter("relative_drift", "", "ε: the clock is fast", (-0.2, 0.2), (-0.02, 0.02), 1e-4),),
    in_data="The offset in time grows along the recording; all frequencies off by one factor.",
    confounded_with={"sensor_time_offset": "Beginning and end of one recording: an offset is the same at both."},
    measure=measure,
)
