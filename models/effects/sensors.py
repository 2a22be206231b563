"""What changes the record of a motion, not the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.arrays import FloatArray
from models.effects.effect import Effect, OnAxis, Parameter, Signals, Values, resampled


def _scaled(true: Signals, values: Values) -> Signals:
    """Scale every channel."""
    carriage = true.carriage * (1 + values["carriage_relative_change"])
    return replace(true, carriage=carriage, nozzle=true.nozzle * (1 + values["nozzle_relative_change"]))


SENSOR_GAIN = Effect(
    name="sensor_gain",
    title="Accelerometers that read too much or too little",
    kind="sensor",
    physics="Sensitivities are calibrated to a few percent.",
    equation="a → (1 + g) a, per channel",
    parameters=(
        Parameter("carriage_relative_change", "", "g of A, B, C", (-0.9, 9), (-0.1, 0.1), 0.02, size="per_tower"),
        Parameter(
            "nozzle_relative_change",
            "",
            "g of x, y, z",
            (-0.9, 9),
            (-0.1, 0.1),
            0.02,
            size="vector3",
            on_axis=OnAxis(size=lambda s: 0.1),
        ),
    ),
    in_data="One channel too large or too small by one factor at all frequencies and places.",
    confounded_with={"effector_mass": "Frequencies: a gain shifts none."},
    measure=_scaled,
    of=("carriages", "axes", "axis"),
    needs="accelerometer",
    remedy="Nothing to mend on the printer: calibrate the accelerometer, or its unit.",
)


def rotation(angles: FloatArray) -> FloatArray:
    """Return the rotation : (3, 3) by the vector `angles` : (3,) rad (Rodrigues' formula)."""
    angle = float(np.linalg.norm(angles))
    x, y, z = angles
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sinc(angle / np.pi) * cross + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * cross @ cross


def _turned(true: Signals, values: Values) -> Signals:
    """Rotate the nozzle's signals to the sensor's axes."""
    # A sensor rotated by R reads Rᵀ a in its own axes; as rows, a R.
    return replace(true, nozzle=true.nozzle @ rotation(np.radians(values["angles_deg"])))


SENSOR_MISALIGNMENT = Effect(
    name="sensor_misalignment",
    title="The nozzle's accelerometer is mounted askew",
    kind="sensor",
    physics="The sensor's axes are turned against the printer's.",
    equation="a → Rᵀ a, R the turn by the rotation vector φ",
    parameters=(Parameter("angles_deg", "degrees", "φ about x, y, z", (-180, 180), (-5, 5), 1.0, size="vector3"),),
    in_data="A motion along x shows in y and z, in one proportion at all frequencies.",
    confounded_with={"arm_geometry": "Several places: a turned sensor errs alike everywhere."},
    measure=_turned,
    remedy="Nothing to mend on the printer: mount the accelerometer along the axes.",
)


def _shifted(true: Signals, values: Values) -> Signals:
    """Shift the signals in time."""
    return resampled(true, true.t_s - float(values["offset_s"]))


SENSOR_TIME_OFFSET = Effect(
    name="sensor_time_offset",
    title="A recording whose clock is off by a constant",
    kind="sensor",
    physics="Recorder and motion are started by different hands.",
    equation="a(t) → a(t − τ)",
    parameters=(Parameter("offset_s", "s", "τ: the record is late", (-10, 10), (-0.01, 0.01), 1e-4),),
    in_data="All channels late alike.",
    confounded_with={
        "command_delay": "Alike in every channel: only position sensors on the command's clock can tell.",
        "belt_damping": "Tones above the resonance: there an offset turns the phase on, belts only once.",
    },
    measure=_shifted,
    shifts_time=True,
    remedy="Nothing to mend on the printer: join captures by the firmware's clock (ffcomp record join).",
)


def _by_its_clock(true: Signals, values: Values) -> Signals:
    """Sample the signals by the recorder's clock."""
    return resampled(true, true.t_s / (1 + float(values["relative_drift"])))


SENSOR_CLOCK_DRIFT = Effect(
    name="sensor_clock_drift",
    title="A recorder whose clock is fast or slow",
    kind="sensor",
    physics="Accelerometers sample by their own oscillators, which are right to a percent or two.",
    equation="a(t) → a(t / (1 + ε))",
    parameters=(Parameter("relative_drift", "", "ε: the clock is fast", (-0.2, 0.2), (-0.02, 0.02), 1e-4),),
    in_data="The offset in time grows along the recording; all frequencies off by one factor.",
    confounded_with={"sensor_time_offset": "Beginning and end of one recording: an offset is the same at both."},
    measure=_by_its_clock,
    shifts_time=True,
    remedy="Nothing to mend on the printer: join captures by the firmware's clock (ffcomp record join).",
)

EFFECTS = (SENSOR_GAIN, SENSOR_MISALIGNMENT, SENSOR_TIME_OFFSET, SENSOR_CLOCK_DRIFT)
