"""Declare a constant time offset of a recording."""

from __future__ import annotations

from collections.abc import Mapping

from models.arrays import FloatArray
from models.effects.effect import Effect, Parameter, Signals, resampled


def measure(true: Signals, values: Mapping[str, FloatArray]) -> Signals:
    """Shift the signals in time."""
    return resampled(true, true.t_s - float(values["offset_s"]))


EFFECT = Effect(
    name="sensor_time_offset",
    title="A recording whose clock is off by a constant",
    kind="sensor",
    physics="Recorder and motion are started by different hands.",
    equation="a(t) → a(t − τ)",
    parameters=(Parameter("offset_s", "s", "τ: the record is late", (-10, 10), (-0.01, 0.01), 1e-4),),
    in_data="All channels late alike.",
    confounded_with={"command_delay": "Alike in every channel: only position sensors on the command's clock can tell."},
    measure=measure,
)
