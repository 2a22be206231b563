"""Accelerometer captures of a planned excitation → frequency responses.

A capture holds neither the start of the motion nor the command; the plan's file holds the command exactly. The capture
is aligned with the simulated acceleration of the starting machine, brought onto the command's clock, and analysed over
the plan's whole periods. The remaining error of the start is a delay that is fitted with the parameters
(`FrequencyResponse.clock`): a drive's own delay and a capture's are told apart by resonances, not by alignment.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identify.experiment import AXES, TOWERS, Experiment, Plan
from ffcomp.measurement.alignment import align
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.estimators import periodic_frf
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.vibration import read_capture
from models.arrays import FloatArray
from models.machine import Machine
from models.printer.printer import simulate_printer

RATE_HZ = 3200.0
TAIL_S = 0.5  # simulated beyond the end of the motion, where a capture may still run
STRAIGHT = ("x", "y", "z")


def frfs_from_captures(
    plan: Plan, paths: Sequence[str | Path], machine: Machine, axes: Sequence[str] = STRAIGHT
) -> list[FrequencyResponse]:
    """Estimate three responses a capture: the excited command to the nozzle's acceleration along x, y, z.

    Parameters
    ----------
    paths : one capture each; its name holds the name of its experiment.
    machine : to simulate the expected capture; a rough one serves.
    axes : the printer's x, y and z in the sensor's own axes, such as ("x", "-z", "y").

    Raises
    ------
    MeasurementError
        If a capture belongs to no experiment of the plan, or does not show its motion.
    """
    turn = turning(axes)
    return [r for path in paths for r in _responses(_experiment_of(plan, path), read_capture(path), machine, turn)]


def turning(axes: Sequence[str]) -> FloatArray:
    """Return the matrix (3, 3) from sensor axes to printer axes.

    Raises
    ------
    MeasurementError
        If the three are not x, y and z with signs.
    """
    turn = np.zeros((3, 3))
    for row, text in enumerate(axes):
        name = text.strip().lstrip("+-")
        if name not in STRAIGHT:
            raise MeasurementError(
                "--axes-map", [f"{text!r} is no axis; it is x, y or z, with a minus if it points back."]
            )
        turn[row, STRAIGHT.index(name)] = -1.0 if text.strip().startswith("-") else 1.0
    if abs(np.linalg.det(turn)) != 1.0:
        raise MeasurementError("--axes-map", [f"{', '.join(axes)} does not name each of x, y and z once."])
    return turn


def _experiment_of(plan: Plan, path: str | Path) -> Experiment:
    stem = Path(path).stem
    for experiment in plan.experiments:
        if stem.endswith(experiment.name) or f"{experiment.name}_" in stem or f"{experiment.name}-" in f"{stem}-":
            return experiment
    names = ", ".join(e.name for e in plan.experiments)
    raise MeasurementError(str(path), [f"Its name holds none of the plan's experiments: {names}."])


def _responses(experiment: Experiment, capture: Capture, machine: Machine, turn: FloatArray) -> list[FrequencyResponse]:
    measured = capture.acceleration @ turn.T
    t, expected = _expected(experiment, machine)
    found = align(capture.time_s, measured, t, expected, capture.source, experiment.period_s)
    when = experiment.measured_from_s + np.arange(_samples(experiment) * experiment.periods) / RATE_HZ
    own = capture.time_s[0] + (when - found.offset_s) / found.clock_ratio
    if own[0] < capture.time_s[0] or own[-1] > capture.time_s[-1]:
        rule = f"It covers {capture.time_s[-1] - capture.time_s[0]:.1f} s, not all of the motion to be measured."
        raise MeasurementError(capture.source, [f"{rule} Start capturing before the motion, stop after it."])
    y = _resampled(capture.time_s, measured, own)
    matrix = periodic_frf(_excited(experiment, when), y, RATE_HZ, _samples(experiment), transient_periods=0)
    band = matrix.between(experiment.band.lowest_hz, experiment.band.highest_hz)
    return band.responses(
        [f"cmd_{experiment.direction}"],
        [f"acc_{axis}" for axis in STRAIGHT],
        position_mm=experiment.position_mm,
        source=Path(capture.source).name,
        clock=experiment.name,
    )


def _samples(experiment: Experiment) -> int:
    return round(experiment.period_s * RATE_HZ)


def _expected(experiment: Experiment, machine: Machine) -> tuple[FloatArray, FloatArray]:
    """Simulate the nozzle's acceleration: (n,) s and (n, 3) m/s²."""
    t = np.arange(0.0, experiment.duration_s + TAIL_S, 1 / RATE_HZ)
    motion = simulate_printer(machine, experiment.command(t), 1 / RATE_HZ, hold="linear")
    return t, motion.nozzle_acceleration


def _excited(experiment: Experiment, t: FloatArray) -> FloatArray:
    """Return the one coordinate that the experiment moves, (n, 1) m."""
    if experiment.direction in TOWERS:
        moved = experiment.command(t)[:, TOWERS.index(experiment.direction)]
    else:
        moved = experiment.nozzle(t)[:, AXES.index(experiment.direction)]
    return ((moved - moved.mean()) * 1e-3)[:, None]


def _resampled(time_s: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(time_s, values)(at))
