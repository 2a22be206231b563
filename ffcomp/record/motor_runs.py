"""The executions of a plan in a log of one motor: found by the motor's commanded steps, which also identify the motor.

The log counts steps from anywhere, in either direction, microsteps or full ones; its clock is fitted to the command.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import fftconvolve

from ffcomp.errors import MeasurementError
from ffcomp.measurement.printer_logs import MotorLog
from ffcomp.record.clock import ClockFit, fit_time, peaks
from ffcomp.record.plan import Experiment, Plan, run_name
from ffcomp.record.result import KEPT_REST_S, Joined, joined_comments, measured_run
from models.arrays import FloatArray
from models.machine import Machine

MOST_STEPS = 2.0  # microsteps rms, of the log's target to the plan
MOST_SPREAD_S = 7e-4  # of the target against the plan: rounding makes 0.2 ms, a shaper of 150 Hz 0.7 to 1.7 ms
OTHER_SIZE = 5e-3  # relative difference that makes steps/mm distinct
LEAST_LIKENESS = 0.98  # correlation of a place in the log with a motor's motion, squared
COARSE_HZ, FINE_HZ = 200.0, 2000.0
PADDED_S = 0.5  # the motor rests before the log begins and after it ends
LATEST_S = 0.05  # into the motion: A1 begins the log when the motor begins to move
MOTORS = "ABC"
SIZES = ("steps_per_mm", "full_steps_per_mm")
BLIND = (
    "Logs of motors show what motors do: friction, a torque angle, a delay. They are blind to arms, effector and "
    "frame, and take the motor's angle for its carriage's place."
)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A place in the log as a motor's execution of an experiment."""

    experiment: Experiment
    motor: int
    clock: ClockFit
    steps_per_mm: float  # of the log; its sign is the direction
    zero: float  # steps, at height 0
    apart: float  # microsteps rms, of the target to the plan
    spread_s: float  # of the target in time, as a shaper does it
    of_this_size: bool  # the steps/mm are the machine file's

    @property
    def good(self) -> bool:
        """Whether the motor was commanded what the plan says."""
        return self.of_this_size and self.apart <= MOST_STEPS and self.spread_s <= MOST_SPREAD_S

    @property
    def span(self) -> tuple[float, float]:
        """From when to when, s from the log's first row."""
        begin = -self.clock.offset_s / self.clock.ratio
        return begin, begin + self.experiment.duration_s / self.clock.ratio


def motor_runs(log: MotorLog, plan: Plan, machine: Machine, before: Sequence[Joined]) -> list[Joined]:
    """Make a measured run of each execution that the log of a motor holds; MeasurementError if it holds none, and why.

    before : the runs of the logs before, whose numbers are taken
    """

    def refusal(*sentences: str) -> MeasurementError:
        return MeasurementError(log.source, [" ".join(sentences)])

    if not np.array_equal(machine.kinematics.motors, np.eye(3)):
        raise refusal(
            f"The motors of {machine.name} move its axes together, and one motor's log does not show an axis' place.",
            "Record this printer with an accelerometer.",
        )
    if not set(SIZES) & set(machine.steps.stated):
        raise refusal(
            f"It counts steps, and the file of {machine.name} does not state their size.",
            "Write steps_per_mm (and full_steps_per_mm) under [steps]: M92 shows them.",
        )
    fits = _fits(log, plan, machine)
    chosen = _apart([each for each in fits if each.good])
    if not chosen:
        raise refusal(_nearest(log, plan, machine, fits))
    taken, joined = [each.name for each in before], list[Joined]()
    for fit in sorted(chosen, key=lambda each: each.span[0]):
        motor, experiment = MOTORS[fit.motor], fit.experiment.name
        others = [each for each in fits if each.good and each.motor != fit.motor and _overlap(fit, each)]
        if others:
            raise refusal(
                f"It may be of motor {motor} or of motor {MOTORS[others[0].motor]}: both move alike in {experiment}.",
                f"End the file's name with the motor, as in duet-{motor}.csv.",
            )
        names = [run_name(f"{experiment}-{motor}", k) for k in range(1, plan.repeats + 1)]
        free = [name for name in names if name not in taken]
        if not free:
            raise refusal(f"There are {plan.repeats} logs of motor {motor} in {experiment} already. Leave one out.")
        taken.append(free[0])
        joined.append(_joined(log, fit, names.index(free[0]) + 1, free[0]))
    return joined


# The search


def _fits(log: MotorLog, plan: Plan, machine: Machine) -> list[_Fit]:
    """Fit each experiment wherever it may be, with the motor that the file's name ends with (`…-A.csv`), or all."""
    named = re.search(r"(?:^|[-_. ])([ABC])$", Path(log.source).stem)
    fits = []
    for experiment, motor in product(plan.experiments, range(3) if named is None else [MOTORS.index(named[1])]):
        t = np.arange(-PADDED_S, experiment.duration_s + PADDED_S, 1 / FINE_HZ)
        way = CubicSpline(t, machine.kinematics.inverse(experiment.motion.nozzle(t))[:, motor])
        places = _places(log, way, experiment.duration_s)
        fits += [_fit(log, experiment, motor, machine, way, begin) for begin in places]
    return [fit for fit in fits if fit is not None]


def _places(log: MotorLog, way: CubicSpline, duration_s: float) -> list[float]:
    """Return when the motion may begin, s from the log's first row: where the target is its image to a scale."""
    since = log.time_s - log.time_s[0]
    at = np.arange(-PADDED_S, since[-1] + PADDED_S, 1 / COARSE_HZ)
    target = np.interp(at, since, log.target)
    target = target - target.mean()
    planned = way(np.arange(0.0, duration_s, 1 / COARSE_HZ))
    planned = planned - planned.mean()
    n = len(planned)
    if n > len(target):
        return []
    sums = [np.concatenate([[0.0], np.cumsum(each)]) for each in (target, target**2)]
    first, second = (each[n:] - each[:-n] for each in sums)
    power = np.maximum(second - first**2 / n, 1e-6 * max(float(target @ target), 1e-300)) * float(planned @ planned)
    likeness = fftconvolve(target, planned[::-1], mode="valid") ** 2 / np.maximum(power, 1e-300)
    return at[peaks(likeness, n // 2, least=LEAST_LIKENESS)].tolist()


def _fit(
    log: MotorLog, experiment: Experiment, motor: int, machine: Machine, way: CubicSpline, begin: float
) -> _Fit | None:
    """Fit clock and steps/mm; the zero with the machine file's steps/mm, if they are those."""
    since = log.time_s - log.time_s[0]
    within = (since >= begin) & (since <= begin + experiment.duration_s)
    since, target = since[within], log.target[within]
    if len(since) < COARSE_HZ * 0.5 * experiment.duration_s:
        return None

    def columns(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.column_stack([way(t), np.ones(len(t))]), way(t, 1)[:, None]

    clock, (scale, _) = fit_time(since, target, columns, (-begin, 1.0), free_ratio=True)
    sizes = {
        key: float(size[motor])
        for key, size in zip(SIZES, (machine.steps.per_motor, machine.steps.full_per_motor), strict=True)
        if key in machine.steps.stated
    }
    near = next((size for size in sizes.values() if abs(abs(scale) / size - 1.0) < OTHER_SIZE), None)
    size = float(scale if near is None else np.copysign(near, scale))
    tau = clock.offset_s + clock.ratio * since
    zero = float(np.mean(target - size * way(tau)))
    residual = target - size * way(tau) - zero
    microsteps = float(np.sqrt(np.mean(residual**2))) / abs(size) * float(machine.steps.per_motor[motor])
    spread = _spread(tau, size, way, residual)
    return _Fit(experiment, motor, clock, size, zero, microsteps, spread, near is not None)


def _spread(tau: FloatArray, size: float, way: CubicSpline, residual: FloatArray) -> float:
    """Return the spread of the target, s.

    Pulses with a spread of σ, as a shaper has them, add σ²/2 times the acceleration to a motion, plus a delay.
    """
    columns = np.column_stack([way(tau, 2), way(tau, 1), tau * way(tau, 1), np.ones(len(tau))])
    scale = size * np.linalg.norm(columns, axis=0)
    share = np.linalg.lstsq(size * columns / scale, residual, rcond=None)[0][0] / scale[0]
    return float(np.sqrt(2.0 * max(share, 0.0)))


def _apart(fits: Sequence[_Fit]) -> list[_Fit]:
    """Keep of fits of one time the best."""
    kept = list[_Fit]()
    for fit in sorted(fits, key=lambda each: each.apart):
        if not any(_overlap(fit, each) for each in kept):
            kept.append(fit)
    return kept


def _overlap(first: _Fit, second: _Fit) -> bool:
    return first.span[0] < second.span[1] and second.span[0] < first.span[1]


def _nearest(log: MotorLog, plan: Plan, machine: Machine, fits: Sequence[_Fit]) -> str:
    """Say why a log holds none of the plan's experiments, by the one that is nearest."""
    near = min(fits, key=lambda each: (not each.of_this_size, each.apart), default=None)
    lasts, shortest = log.time_s[-1] - log.time_s[0], min(each.duration_s for each in plan.experiments)
    if near is None and lasts < shortest - LATEST_S:
        return (
            f"It lasts {lasts:.2f} s, and the shortest motion of the plan {shortest:.2f} s: it was cut off. Record it "
            "again, with more samples (S is the rate times the seconds)."
        )
    if near is None:
        return (
            "None of the plan's motions is in the target of its motor, not even with other steps/mm: it is of another "
            "plan, began after the motion or ended before it. Give the plan that its G-code was made with, and record "
            "from before the motion until after it."
        )
    motor, what = MOTORS[near.motor], near.experiment.name
    if not near.of_this_size and near.spread_s <= MOST_SPREAD_S:
        stated = ", ".join(f"{key} = {getattr(machine.steps, key)}" for key in SIZES if key in machine.steps.stated)
        return (
            f"Its motion is that of motor {motor} in {what}, but with {abs(near.steps_per_mm):.5g} steps/mm, and the "
            f"machine file says {stated}. Correct it in the machine file (steps_per_mm if the log counts microsteps, "
            "full_steps_per_mm if it counts full steps) or in the printer's M92."
        )
    return (
        f"Its target is {near.apart:.1f} microsteps rms from motor {motor} of {what} ({MOST_STEPS:g} may be), and "
        f"spread by {1e3 * near.spread_s:.1f} ms ({1e3 * MOST_SPREAD_S:g} may be): the input shaper was on (M593 "
        'P"none" switches it off), the speed factor was not 100 %, or it is another motion. Run the plan\'s G-code as '
        "it is, and record it again."
    )


# The run


def _joined(log: MotorLog, fit: _Fit, repeat: int, name: str) -> Joined:
    experiment, clock = fit.experiment, fit.clock
    tau = clock.experiment_time(log.time_s)
    if tau[0] > LATEST_S or tau[-1] < experiment.duration_s:
        reason = (
            f"It runs from {tau[0]:.2f} to {tau[-1]:.2f} s of a motion of {experiment.duration_s:.2f} s: it was "
            "cut off. Record it again, from before the motion, and with more samples (S)."
        )
        raise MeasurementError(log.source, [reason])
    step = 1.0 / float(np.round(log.sample_rate_hz))
    first = max(min(float(tau[0]), -LATEST_S), -KEPT_REST_S[0])  # rows that the log lacks are gaps
    last = min(float(tau[-1]), experiment.duration_s + KEPT_REST_S[1])
    grid = step * np.arange(np.ceil(first / step), np.floor(last / step) + 1)
    place = np.asarray(CubicSpline(tau, (log.measured - fit.zero) / fit.steps_per_mm)(grid))
    place[grid < tau[0]] = np.nan
    comments = joined_comments(clock, log.source, experiment.name, repeat, "log")
    motor = {"motor": f"{MOTORS[fit.motor]}, {fit.steps_per_mm:g} steps/mm"}
    run = measured_run(name, experiment.motion, grid, {f"pos_{MOTORS[fit.motor]}": place}, comments | motor)
    return Joined(run, experiment.name, repeat, clock, 0, log.source, "", float(grid[0]))
