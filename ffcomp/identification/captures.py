"""Accelerometer captures of a planned excitation → frequency responses.

A capture holds neither the start of the motion nor the command; the plan's file holds the command exactly. The capture
is aligned below 20 Hz with the simulated acceleration of the starting machine, brought onto the command's clock, and
analysed over the plan's whole periods. The remaining error of the start is a delay that is fitted with the parameters
(`FrequencyResponse.clock`): a drive's own delay and a capture's are told apart by resonances, not by alignment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.estimators import periodic_frf
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.measurement.recording import Recording
from ffcomp.measurement.recording_frfs import frfs_from_recordings
from ffcomp.measurement.vibration import read_capture
from ffcomp.record.axes import STRAIGHT, turning
from ffcomp.record.clock import ClockFit, Reference, every_clock, expectation, fit_clock, thinned
from ffcomp.record.excitation import excited_coordinate
from ffcomp.record.plan import Experiment, Plan
from ffcomp.record.result import NO_ACCELERATIONS
from models.arrays import FloatArray
from models.machine import Machine

RATE_HZ = 3200.0
LEAD_S = 0.2  # simulated at rest before the motion
CLEAR_CORRELATION = 0.4  # of what a rough machine file expects
BAND_HZ = (5.0, 150.0)  # that such motions excite
HALF_WIDTH_HZ = 2.0  # zigzags and loops have a few lines in a hertz only
VARIANCE_FACTOR = 4.0  # polynomials of such wide windows err by twice the noise, measured on simulated captures
MOST_NOISE = 0.15  # of a response's values: beyond it, as across the axes at the centre, it tells nothing
INPUTS = ("cmd_x", "cmd_y")  # z moves too little beside them


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


def _experiment_of(plan: Plan, path: str | Path) -> Experiment:
    stem = Path(path).stem
    for experiment in plan.experiments:
        if stem.endswith(experiment.name) or f"{experiment.name}_" in stem or f"{experiment.name}-" in f"{stem}-":
            return experiment
    names = ", ".join(e.name for e in plan.experiments)
    raise MeasurementError(str(path), [f"Its name holds none of the plan's experiments: {names}."])


def _responses(experiment: Experiment, capture: Capture, machine: Machine, turn: FloatArray) -> list[FrequencyResponse]:
    excitation = experiment.excitation
    if excitation is None:
        raise MeasurementError(capture.source, [f"{experiment.name} is no periodic excitation."])
    measured = capture.acceleration @ turn.T
    clock = _clock(experiment, capture, measured, machine)
    samples = round(excitation.band.period_s * RATE_HZ)
    when = experiment.measured_from_s + np.arange(samples * excitation.periods) / RATE_HZ
    capture_time = capture.time_s[0] + (when - clock.offset_s) / clock.ratio
    if capture_time[0] < capture.time_s[0] or capture_time[-1] > capture.time_s[-1]:
        rule = f"It covers {capture.time_s[-1] - capture.time_s[0]:.1f} s, not all of the motion to be measured."
        raise MeasurementError(capture.source, [f"{rule} Start capturing before the motion, stop after it."])
    y = CubicSpline(capture.time_s, measured)(capture_time)
    moved = excited_coordinate(machine.kinematics, excitation.direction, experiment.motion, when)
    matrix = periodic_frf(((moved - moved.mean()) * 1e-3)[:, None], y, RATE_HZ, samples, transient_periods=0)
    band = matrix.between(excitation.band.lowest_hz, excitation.band.highest_hz)
    return band.responses(
        [f"cmd_{excitation.direction}"],
        [f"acc_{axis}" for axis in STRAIGHT],
        position_mm=experiment.position_mm,
        source=Path(capture.source).name,
        clock=experiment.name,
    )


def _clock(experiment: Experiment, capture: Capture, measured: FloatArray, machine: Machine) -> ClockFit:
    """Fit the capture's clock; the motion repeats, but its marker does not."""
    if not np.ptp(measured, axis=0).any():
        raise MeasurementError(capture.source, ["Nothing moves, so nothing can be aligned."])
    expected = expectation(experiment.motion, machine, LEAD_S, with_signatures=False)
    reference = Reference(expected)
    since, record = thinned(capture.time_s, measured)
    matches = every_clock(since, record, reference, expected, known_axes=True)
    start = matches.starts[int(np.abs(matches.correlation).sum(axis=(1, 2)).argmax())]
    clock = fit_clock(since, record, reference, start, free_ratio=True)
    if clock.correlation < CLEAR_CORRELATION:
        raise MeasurementError(
            capture.source,
            [
                f"The record does not match the expected motion (correlation {clock.correlation:.2f} below 20 Hz; at "
                f"least {CLEAR_CORRELATION:g} is a match): is it of another motion, are its axes turned, or is its "
                "rate wrong?"
            ],
        )
    return clock


# The rest is of moves that are no periodic excitation


def responses_of(recordings: Sequence[Recording], plan: Plan, band_hz: tuple[float, float]) -> list[FrequencyResponse]:
    """Estimate the responses to x and y at each place of a plan, from all its experiments there together.

    Raises
    ------
    MeasurementError
        For a log of a motor.
    """
    for recording in recordings:
        if not recording.acceleration:
            raise MeasurementError(recording.comments["capture"], [NO_ACCELERATIONS])
    experiments = {each.name: each for each in plan.experiments}
    places: dict[int, list[Recording]] = {}
    for recording in recordings:
        places.setdefault(experiments[recording.comments["experiment"]].place, []).append(recording)
    responses = []
    for place, members in sorted(places.items()):
        at = _position(experiments[members[0].comments["experiment"]])
        responses += _of_place(members, place, at, (max(BAND_HZ[0], band_hz[0]), min(BAND_HZ[1], band_hz[1])))
    return responses


def _position(experiment: Experiment) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in experiment.position_mm)
    return x, y, z


def _of_place(
    members: Sequence[Recording], place: int, position: tuple[float, float, float], band_hz: tuple[float, float]
) -> list[FrequencyResponse]:
    """Estimate the responses at one place; a capture's start is known to a fraction of a millisecond: one clock."""
    longest = max(len(recording.time_s) for recording in members)
    alike = [_resting(recording, longest) for recording in members]
    responses = frfs_from_recordings(alike, *band_hz, half_width_hz=HALF_WIDTH_HZ, position_mm=position)
    name = f"place {place}, {len(members)} captures"
    known = [r for r in responses if r.input in INPUTS and _noise(r) < MOST_NOISE]
    return [replace(r, variance=r.variance * VARIANCE_FACTOR, source=name, clock=f"place-{place}") for r in known]


def _noise(response: FrequencyResponse) -> float:
    """Return the noise as a share of the values."""
    return float(np.sqrt(response.variance.sum() / np.sum(np.abs(response.value) ** 2)))


def _resting(recording: Recording, count: int) -> Recording:
    """Lengthen a recording, which ends at rest, to so many rows."""
    more = count - len(recording.time_s)
    return replace(
        recording,
        time_s=np.arange(count) / recording.sample_rate_hz,
        command=np.concatenate([recording.command, np.repeat(recording.command[-1:], more, axis=0)]),
        acceleration={name: _with_zeros(values, more) for name, values in recording.acceleration.items()},
        position={},
        gaps=np.concatenate([recording.gaps, np.zeros(more, dtype=bool)]),
    )


def _with_zeros(values: FloatArray, more: int) -> FloatArray:
    return np.concatenate([values, np.zeros(more)])
