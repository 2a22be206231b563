"""Captures that the virtual printer's own accelerometer would write of a plan, in its firmware's format.

Gravity, noise, counts of 3.9 mg (an ADXL345), a tilt, a clock that is up to 1 % off: as on owners' printers. The
join gets neither the start of the motion nor the chip's orientation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ffcomp.errors import RequestError
from ffcomp.measurement.sensors import G
from ffcomp.record.plan import Experiment, load_plan, run_name
from gcode.atomic_write import replace_atomically
from gcode.dialect import KLIPPER, REPRAPFIRMWARE
from gcode.program import Program
from models.arrays import FloatArray
from models.effects.catalogue import measured
from models.machine import Machine
from models.printer.printer import simulate_printer

COUNT = 3.9e-3 * G  # of an ADXL345, m/s²
WORST_RATE = 0.01  # of the chip's clock
LATEST_S = 0.15  # delay of RepRapFirmware's start
STATED = 3e-3  # error of its stated rate
SPARE_S = 0.4  # simulated beyond a capture
PLAYED_HZ = 3200.0
NAMES = {KLIPPER: "adxl345-{}.csv", REPRAPFIRMWARE: "{}.csv"}


@dataclass(frozen=True)
class Sensor:
    """An accelerometer on the nozzle holder."""

    rate_hz: float = 3200.0
    noise_m_per_s2: float = 0.15
    tilt_deg: float = 2.0
    seed: int = 1


def write_captures(
    plan_file: Path,
    program: Program,
    machine: Machine,
    plant: Machine,
    folder: Path,
    sensor: Sensor,
    flavor: str = KLIPPER,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Path]:
    """Write one capture for each execution of a plan.

    Raises RequestError if the G-code is not the plan's, or the firmware records nothing itself.

    program : the plan's G-code
    machine : what the firmware knows; the plant is what it drives
    progress : called with the share that is done
    """
    if flavor not in NAMES:
        raise RequestError(f"{flavor} has no accelerometer; --flavor klipper or reprapfirmware.")
    plan, ends = load_plan(plan_file), program.moves.end[:, :3]
    for each in plan.experiments:
        corners = each.motion.nozzle(np.array([0.0, each.duration_s]))
        if not all((np.abs(ends - place).max(axis=1) < 1e-3).any() for place in corners):
            raise RequestError(f"{each.name} of {plan_file} is not in the G-code: give the file written with it.")
    rng = np.random.default_rng(sensor.seed)
    turn, rate = _tilt(rng, sensor.tilt_deg), sensor.rate_hz * rng.uniform(1 - WORST_RATE, 1 + WORST_RATE)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    runs = plan.runs()
    for k, (experiment, repeat) in enumerate(runs):
        begin, end = -plan.rest_before_s, experiment.duration_s + plan.rest_after_s
        late = rng.uniform() / rate if flavor == KLIPPER else rng.uniform(0.0, LATEST_S)
        t = np.arange(begin + late, end, 1.0 / rate)
        signal = _sensor_signal(experiment, machine, plant, t) @ turn.T
        counts = np.rint((signal + sensor.noise_m_per_s2 * rng.standard_normal(signal.shape)) / COUNT) * COUNT
        path = folder / NAMES[flavor].format(run_name(experiment.name, repeat))
        if flavor == KLIPPER:
            lines = _klipper(t - begin + 60.0 + 20.0 * k, counts)
        else:
            lines = _reprapfirmware(counts, rate * (1 + STATED * rng.uniform(-1.0, 1.0)))
        replace_atomically(path, [text.encode() for text in lines])
        written.append(path)
        progress((k + 1) / len(runs))
    return written


def _tilt(rng: np.random.Generator, tilt_deg: float) -> FloatArray:
    """Return a rotation (3, 3) about a horizontal axis of any direction."""
    about = rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(about), np.sin(about), 0.0])
    return np.asarray(Rotation.from_rotvec(tilt_deg * axis, degrees=True).as_matrix())


def _sensor_signal(experiment: Experiment, machine: Machine, plant: Machine, t: FloatArray) -> FloatArray:
    """Return what the nozzle holder feels at times (n,) of an experiment, gravity included: (n, 3) m/s²."""
    played = np.arange(float(t[0]) - SPARE_S, float(t[-1]) + 0.01, 1.0 / PLAYED_HZ)
    motion = simulate_printer(plant, machine.kinematics.inverse(experiment.motion.nozzle(played)), 1.0 / PLAYED_HZ)
    signal = CubicSpline(played, measured(plant, motion.signals).nozzle)(t)
    return np.asarray(signal + np.array([0.0, 0.0, G]))


def _klipper(print_time_s: FloatArray, acceleration: FloatArray) -> list[str]:
    table = np.column_stack([print_time_s, 1e3 * acceleration])
    rows = "%.6f,%.6f,%.6f,%.6f\n" * len(table) % tuple(table.ravel().tolist())
    return ["#time,accel_x,accel_y,accel_z\n", rows]


def _reprapfirmware(acceleration: FloatArray, stated_hz: float) -> list[str]:
    rows = (f"{k},{x:.4f},{y:.4f},{z:.4f}\n" for k, (x, y, z) in enumerate((acceleration / G).tolist()))
    return ["Sample,X,Y,Z\n", *rows, f"Rate {stated_hz:.0f}, overflows 0\n"]
