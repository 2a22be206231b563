"""A run of one axis by itself: its drive and its measured motion, on one uniform clock.

Columns: `t_s`; what drove it, `cmd_q_mm`, `force_n`, `current_a`, `voltage_v` or `duty`; any of `pos_q_mm`,
`pos_motor_mm`, `vel_q_mm_per_s`, `acc_q_m_per_s2`, and the measured `force_n` of a position-driven axis; optionally,
`supply_v` and `extra_force_n`, a known force. Of what turns: `pos_q_rad`, `torque_n_m` and so on, or degrees. An empty
field or NaN is a gap of a sensor; what drives the axis has none.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.clock import Clock, clock_of
from ffcomp.measurement.recording import Run
from ffcomp.measurement.table import closest, read_table, read_text, repeated_columns
from models.arrays import FloatArray
from models.vibration.driven_axis import Input

MM_PER_DEG = 1e3 * math.pi / 180  # inside, 1 rad is 1 m
SMALL = {"_mm": 1.0, "_rad": 1e3, "_deg": MM_PER_DEG}  # ending of a column -> its unit in mm
LARGE = {"_m_per_s2": 1.0, "_rad_per_s2": 1.0, "_deg_per_s2": 1e-3 * MM_PER_DEG}
# column -> what it is, and its unit in ours
INPUTS: dict[str, tuple[Input, float]] = {
    **{f"cmd_q{ending}": ("position", scale) for ending, scale in SMALL.items()},
    "force_n": ("force", 1.0),
    "torque_n_m": ("force", 1.0),
    "current_a": ("current", 1.0),
    "voltage_v": ("voltage", 1.0),
    "duty": ("duty", 1.0),
}
SENSORS = {
    **{f"{name}{ending}": (name, scale) for name in ("pos_q", "pos_motor") for ending, scale in SMALL.items()},
    **{f"vel_q{ending}_per_s": ("vel_q", scale) for ending, scale in SMALL.items()},
    **{f"acc_q{ending}": ("acc_q", scale) for ending, scale in LARGE.items()},
}
BESIDE = {"supply_v": ("supply", 1.0), "extra_force_n": ("extra", 1.0), "extra_torque_n_m": ("extra", 1.0)}
LOWEST_RATE_HZ = 20.0
SPEED_OFF = 0.01  # of its signal: tolerance of a measured speed against the position's
OF_POWER = 0.95  # of a measured speed: the lowest frequency lines with this power are compared


@dataclass(frozen=True, eq=False)
class AxisRun(Run):
    """One experiment of n samples at a constant rate."""

    source: str  # the file, as the user named it
    time_s: FloatArray  # (n,) s, uniform
    drive: FloatArray  # (n,) mm of the commanded position, or N, A, V, a duty
    command_space: Input  # what it drives
    acceleration: dict[str, FloatArray]  # "acc_q" -> (n,) m/s²
    position: dict[str, FloatArray]  # "pos_q", "pos_motor" -> (n,) mm
    folder: str = ""  # of the file, where another folder has one of the same name
    other: dict[str, FloatArray] = field(default_factory=dict)  # "vel_q" -> (n,) mm/s, "force" -> (n,) N
    supply_v: FloatArray | None = None  # (n,) V of the drive
    extra: FloatArray | None = None  # (n,) N, known extra force
    remarks: tuple[str, ...] = ()  # omissions, in sentences

    @property
    def signals(self) -> dict[str, FloatArray]:
        """All that was measured."""
        return {**self.acceleration, **self.position, **self.other}

    @property
    def place(self) -> FloatArray:
        """Where the load was, else the motor, (n,) mm; NaN where no position was measured."""
        nowhere = np.full(len(self.time_s), np.nan)
        return self.position.get("pos_q", self.position.get("pos_motor", nowhere))

    @property
    def by_force(self) -> bool:
        """Whether a force drives it, or what makes one."""
        return self.command_space != "position"

    @property
    def command(self) -> FloatArray:
        """What the axis was given, (n, 1) mm; of a force, 10 for the largest: repeats must agree to a thousandth."""
        scale = 10.0 / max(float(np.abs(self.drive).max()), 1e-300) if self.by_force else 1.0
        return scale * self.drive[:, None]


def read_axis_run(path: str | Path, drive: Input | None = None) -> AxisRun:
    """Read one run; a MeasurementError reports every mistake in the file at once.

    drive : what drives the axis (`axis.input` of its machine file), for files with several; None: the only one.
    """
    table = read_table(path, read_text(path))
    chosen, problems = _driving(table.columns, drive)
    problems = [*table.problems, *repeated_columns(table.columns), *problems]
    if problems:
        raise MeasurementError(str(path), problems)
    timed = np.isfinite(table.column("t_s"))
    clock, problems = clock_of(table.column("t_s")[timed], table.row[timed], LOWEST_RATE_HZ)
    if clock is None or problems:
        raise MeasurementError(str(path), problems)
    sensors = _sensors(chosen)
    used = {chosen: ("drive", INPUTS[chosen][1])} | BESIDE | sensors
    columns = {name: clock.on_grid(table.column(name)[timed]) for name in table.columns if name in used}
    problems = _silent(columns, clock, sensors)
    if problems:
        raise MeasurementError(str(path), problems)
    signals = {used[name][0]: used[name][1] * x for name, x in columns.items()}
    remarks = _left_out(path, table.columns, used)
    if late := _late_speed(signals, clock):
        signals.pop("vel_q")
        remarks.append(f"{Path(path).name}: {late}")
    return AxisRun(
        str(path),
        clock.grid_s,
        signals.pop("drive"),
        INPUTS[chosen][0],
        {key: x for key, x in signals.items() if key.startswith("acc")},
        {key: x for key, x in signals.items() if key.startswith("pos")},
        other={key: x for key, x in signals.items() if key in ("vel_q", "force")},
        supply_v=signals.get("supply"),
        extra=signals.get("extra"),
        remarks=tuple(remarks),
    )


def _sensors(chosen: str) -> dict[str, tuple[str, float]]:
    """Return the columns that are sensors; the force of an axis that a position drives is one."""
    measured = dict.fromkeys(("force_n", "torque_n_m"), ("force", 1.0))
    return SENSORS | (measured if INPUTS[chosen][0] == "position" else {})


def _driving(columns: tuple[str, ...], drive: Input | None) -> tuple[str, list[str]]:
    """Return the column of what drove the axis, and the problems of a run's header, in full sentences."""
    problems = []
    if "t_s" not in columns:
        problems.append("Column t_s (time, seconds) is missing; every run needs it.")
    inputs = [name for name in dict.fromkeys(columns) if name in INPUTS]
    chosen = [name for name in inputs if INPUTS[name][0] == drive] or inputs
    if len(chosen) != 1:
        problems.append(
            "A run of one axis needs what drove it: cmd_q_mm (a position), force_n, current_a, voltage_v or duty, one "
            f"of them.{_mistyped(columns, INPUTS) if not chosen else ''}"
        )
        return "force_n", problems
    sensors = _sensors(chosen[0])
    if not any(name in sensors for name in columns):
        known = "pos_q_mm, pos_motor_mm, vel_q_mm_per_s, acc_q_m_per_s2 (or rad, deg)"
        problems.append(f"No sensor column is there; a run needs at least one of {known}.{_mistyped(columns, sensors)}")
    names = [sensors[name][0] for name in columns if name in sensors]
    problems += [f"{name} has two units; give one column of it." for name in set(names) if names.count(name) > 1]
    return chosen[0], problems


def _mistyped(columns: tuple[str, ...], known: Collection[str]) -> str:
    """Ask whether a column that is not known means one that is, in a sentence; '' if none is near."""
    for name in columns:
        if name not in ("t_s", *INPUTS, *SENSORS, *BESIDE) and (near := closest(name, list(known))):
            return f" Column {name!r} is not known; did you mean {near!r}?"
    return ""


def _left_out(path: str | Path, columns: tuple[str, ...], used: Collection[str]) -> list[str]:
    """Say which columns are not used."""
    sentences = []
    for name in dict.fromkeys(columns):
        if name == "t_s" or name in used:
            continue
        why = "is another input than the machine file's" if name in INPUTS else "is none of a run of one axis"
        near = None if name in INPUTS else closest(name, list(used))
        hint = f"; did you mean {near!r}?" if near else "."
        sentences.append(f"{Path(path).name}: column {name!r} {why}, and is left out{hint}")
    return sentences


def _late_speed(signals: dict[str, FloatArray], clock: Clock) -> str:
    """Say that a measured speed comes after that of the measured position, and by how much; '' where it does not.

    Both are of one motion, and their ratio at each frequency is their sensors' alone, whatever drives the axis: its
    delay is the slope of its phase, fitted with the power of the speed as weight.
    """
    if not {"vel_q", "pos_q"} <= signals.keys():
        return ""
    speed, place = signals["vel_q"], signals["pos_q"]
    if not (np.isfinite(speed).all() and np.isfinite(place).all()):
        return ""
    step = float(clock.grid_s[1] - clock.grid_s[0])
    window = np.hanning(len(speed))
    omega = 2 * np.pi * np.fft.rfftfreq(len(speed), step)[1:]
    measured = np.fft.rfft(window * (speed - speed.mean()))[1:]
    power = np.abs(measured) ** 2
    band = (np.cumsum(power) <= OF_POWER * power.sum()) & (omega * step < np.pi / 4)
    omega, measured, power = omega[band], measured[band], power[band]
    slope = np.gradient(place, step)
    # a central difference gives sin(ω h)/(ω h) of the speed
    true = np.fft.rfft(window * (slope - slope.mean()))[1:][band] * omega * step / np.sin(omega * step)
    off, moved = float(np.sum(np.abs(measured - true) ** 2)), float(np.sum(np.abs(true) ** 2))
    if off <= SPEED_OFF**2 * np.sum(power) or not moved:
        return ""
    delay_s = -float(np.sum(power * omega * np.angle(measured * true.conj())) / np.sum(power * omega**2))
    shifted = true * np.exp(-1j * omega * delay_s)
    gain = float(np.real(np.vdot(shifted, measured)) / moved)
    if not (delay_s > 0.0 and 0.5 < gain < 2.0 and np.sum(np.abs(measured - gain * shifted) ** 2) <= off / 4):
        return ""  # no filter does that
    return (
        f"the measured speed comes {1e3 * delay_s:.3g} ms after that of the position and is {gain:.3g} times as large, "
        "as if filtered; it is ignored, because the position has the same motion."
    )


def _silent(columns: dict[str, FloatArray], clock: Clock, sensors: Collection[str]) -> list[str]:
    """Report an input with gaps, and sensors without a number or without motion."""
    problems = []
    for name, x in columns.items():
        known = x[np.isfinite(x)]
        if name in sensors and (len(known) < len(x) / 2 or not np.ptp(known) > 0):
            problems.append(f"Column {name} is missing in most rows, or never changes; leave it out.")
        elif name not in sensors and len(known) < len(x):
            at = clock.grid_s[int(np.argmin(np.isfinite(x)))]
            problems.append(
                f"Column {name} is missing at t = {at:.6g} s; what drives the axis must be known throughout."
            )
    return problems
