"""Effects of the sensors: they change the record of a motion, not the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.arrays import FloatArray
from models.effects.effect import EACH, Effect, Signals, Values, amplitude, resampled, shape

JOIN = "Nothing to repair on the printer: join captures by the firmware's clock (ffcomp record join)."


def _scaled(true: Signals, values: Values) -> Signals:
    carriage = true.carriage * (1 + values["carriage_relative_change"])
    return replace(true, carriage=carriage, nozzle=true.nozzle * (1 + values["nozzle_relative_change"]))


SENSOR_GAIN = Effect(
    name="sensor_gain",
    title="Accelerometer gain",
    physics="Sensitivities are calibrated to a few percent.",
    equation="a → (1 + g) a, per channel",
    parameters=(
        amplitude("carriage_relative_change", "g of A, B, C", (-0.9, 9), (-0.1, 0.1), 0.02, EACH),
        amplitude(
            "nozzle_relative_change", "g of x, y, z", (-0.9, 9), (-0.1, 0.1), 0.02, "vector3", usual=lambda s: 1 / 3
        ),
    ),
    in_data="One channel off by the same factor at all frequencies and positions.",
    confounded_with={"effector_mass": "Frequencies: a gain shifts none."},
    measure=_scaled,
    of=("carriages", "axes", "axis"),
    needs="accelerometer",
    remedy="Nothing to repair on the machine: calibrate the accelerometer, or its unit.",
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
    title="A misaligned nozzle accelerometer",
    physics="The sensor's axes are rotated relative to the printer's.",
    equation="a → Rᵀ a, R the rotation by the vector φ",
    parameters=(amplitude("angles_deg", "φ about x, y, z", (-180, 180), (-5, 5), 1.0, "vector3"),),
    in_data="Motion along x shows in y and z, by the same factor at all frequencies.",
    confounded_with={"arm_geometry": "Several positions: a misaligned sensor has the same error everywhere."},
    measure=_turned,
    remedy="Nothing to repair on the printer: mount the accelerometer along the axes.",
)


SENSOR_TIME_OFFSET = Effect(
    name="sensor_time_offset",
    law_of="lateness",
    title="A constant time offset of the recording",
    physics="Recorder and motion are started separately.",
    equation="a(t) → a(t − τ)",
    parameters=(amplitude("offset_s", "τ: the record is late", (-10, 10), (-0.01, 0.01), 1e-4, unit="s"),),
    in_data="All channels are late by the same time.",
    confounded_with={
        "command_delay": "Only position sensors on the command's clock: both shift all accelerations equally.",
        "belt_damping": "Tones above the resonance: there an offset keeps turning the phase, belts do so once.",
    },
    measure=lambda true, values: resampled(true, true.t_s - float(values["offset_s"])),
    shifts_time=True,
    remedy=JOIN,
)


SENSOR_CLOCK_DRIFT = Effect(
    name="sensor_clock_drift",
    title="A fast or slow recorder clock",
    physics="Accelerometers sample with their own oscillators, accurate to a percent or two.",
    equation="a(t) → a(t / (1 + ε))",
    parameters=(amplitude("relative_drift", "ε: the clock is fast", (-0.2, 0.2), (-0.02, 0.02), 1e-4),),
    in_data="The time offset grows along the recording; all frequencies are off by the same factor.",
    confounded_with={"sensor_time_offset": "Beginning and end of one recording: an offset is the same at both."},
    measure=lambda true, values: resampled(true, true.t_s / (1 + float(values["relative_drift"]))),
    shifts_time=True,
    remedy=JOIN,
)


def low_passed(x: FloatArray, rate_hz: float, time_constant_s: float, damping_ratio: float) -> FloatArray:
    """Return a signal, (n,), through T ẏ + y = x, or T² ÿ + 2 ζ T ẏ + y = x where ζ is not zero; at rest before it."""
    from scipy.signal import cont2discrete, lfilter, lfilter_zi

    second = [time_constant_s**2, 2 * damping_ratio * time_constant_s, 1.0]
    poles = second if damping_ratio else [time_constant_s, 1.0]
    b, a, _ = cont2discrete(([1.0], poles), 1 / rate_hz, "foh")
    b = np.ravel(b)
    return np.asarray(lfilter(b, a, x, zi=lfilter_zi(b, a) * x[0])[0])


def _lagging(true: Signals, values: Values) -> Signals:
    columns = np.column_stack([true.position, true.nozzle[:, 0]])
    rate = float((len(true.t_s) - 1) / (true.t_s[-1] - true.t_s[0]))
    for i, (delay, constant) in enumerate(zip(values["delay_s"], values["time_constant_s"], strict=True)):
        if delay > 0.0:
            columns[:, i] = np.interp(true.t_s - delay, true.t_s, columns[:, i])
        if constant > 0.0:
            columns[:, i] = low_passed(columns[:, i], rate, float(constant), float(values["damping_ratio"]))
    nozzle = true.nozzle.copy()
    nozzle[:, 0] = columns[:, 2]
    return replace(true, position=columns[:, :2], nozzle=nozzle)


SENSOR_LAG = Effect(
    name="sensor_lag",
    title="Sensors with a delay or a low-pass",
    physics="Encoders are read in turn, and filters and interfaces delay each sensor differently.",
    equation="T² ÿ + 2 ζ T ẏ + y = x(t − τ);  ζ = 0: T ẏ + y = x(t − τ)",
    parameters=(
        amplitude("delay_s", "τ of pos_q, pos_motor, acc_q", (0, 10), (0, 0.005), 1e-4, "vector3", unit="s"),
        amplitude(
            "time_constant_s",
            "T of pos_q, pos_motor, acc_q",
            (0, 100),
            (0, 0.1),
            1e-4,
            "vector3",
            unit="s",
            usual=lambda s: 1 / s.highest_hz,
            signals=("pos_q", "pos_motor", "acc_q"),
        ),
        shape("damping_ratio", "ζ; 0: of first order", (0, 10), (0, 1), 0.1, default=0.0, starts=(0.7,)),
    ),
    in_data="One sensor's signals lag another's or lack high frequencies.",
    confounded_with={"command_delay": "Two sensors of one motion: a late command is late in both."},
    measure=_lagging,
    of=("axis",),
    needs="two sensors",
    shifts_time=True,
    remedy="Nothing to repair on the axis: state the sensor's lag in the file, or read all sensors at once.",
)
