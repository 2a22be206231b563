"""The executions of a plan in a log of Klipper's data logger: found by the commanded nozzle, exact in time.

What the motors did is the authority on the command: where their steps differ from the nozzle's plan, the input shaper
was on, and the steps are the command.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture, make_capture
from ffcomp.measurement.printer_logs import MotionLog, Samples, Steps
from ffcomp.measurement.table import Table
from ffcomp.record.motion import Commanded
from ffcomp.record.plan import Experiment, Plan, run_name
from ffcomp.record.split import Execution
from models.arrays import FloatArray
from models.kinematics.base import Kinematics
from models.machine import Machine

REST_S = 0.3  # between two motions
NEAR_MM = 0.05  # of the plan's nozzle to the log's
MOST_STEPS = 1.0  # rms, of the motors to the nozzle's plan: more is a shaper
PER_SECOND = 200.0  # places at which nozzles are compared
SETTLES_S = 0.01  # a motor reaches its rest after its last step
RATE_HZ, SMOOTH_HZ = 3200.0, 400.0  # of a command from steps
STEPPERS = (("stepper_a", "stepper_b", "stepper_c"), ("stepper_x", "stepper_y", "stepper_z"))


@dataclass(frozen=True, eq=False)
class Played:
    """A motion as the motors executed it; it begins at zero."""

    spline: Callable[[FloatArray], FloatArray]
    begin_s: float
    end_s: float
    duration_s: float  # of the plan's motion

    def nozzle(self, t_s: FloatArray) -> FloatArray:
        """Return the nozzle's command at the times (k,) s: (k, 3) mm. It rests before and after."""
        return np.asarray(self.spline(np.clip(t_s, self.begin_s, self.end_s)))


def executions(log: MotionLog, plan: Plan, machine: Machine) -> tuple[list[Execution], list[str]]:
    """Return the captures of every execution that the log holds, and sentences about what is in it.

    Raises
    ------
    MeasurementError
        If none of the plan's experiments is in it.
    """
    executed: list[Execution] = []
    notes = list(differences(log, machine))
    made: dict[str, int] = {}
    for begin in _beginnings(log):
        experiment = next((each for each in plan.experiments if _is(log, begin, each)), None)
        if experiment is None or made.get(experiment.name, 0) >= plan.repeats:
            continue
        made[experiment.name] = repeat = made.get(experiment.name, 0) + 1
        played, note = _played(log, begin, experiment, plan, machine.kinematics)
        notes += [f"{run_name(experiment.name, repeat)}: {note}"] if note else []
        for chip, samples in log.sensors.items():
            capture = _capture(log, samples, begin, experiment, plan, run_name(experiment.name, repeat))
            start = (float(capture.time_s[0]) - begin, 1.0)
            executed.append(Execution(capture, experiment, repeat, chip, start, played))
    if not executed:
        raise MeasurementError(
            log.source,
            [
                "None of the plan's experiments is in its commanded motion. Log while the plan's own G-code runs, with "
                "bed mesh and skew correction off as it switches them."
            ],
        )
    return executed, notes


def _beginnings(log: MotionLog) -> list[float]:
    """List the print times at which the nozzle begins to move after a rest."""
    nozzle = log.nozzle
    moving = (nozzle.speed != 0) | (nozzle.acceleration != 0)
    begin, end = nozzle.begin_s[moving], (nozzle.begin_s + nozzle.lasts_s)[moving]
    return [float(t) for t in begin[np.concatenate([[True], begin[1:] - end[:-1] >= REST_S])]]


def _is(log: MotionLog, begin: float, experiment: Experiment) -> bool:
    t = np.linspace(0.0, experiment.duration_s, max(2, int(PER_SECOND * experiment.duration_s)))
    return bool(np.abs(log.nozzle.at(begin + t) - experiment.motion.nozzle(t)).max() < NEAR_MM)


def _capture(log: MotionLog, samples: Samples, begin: float, experiment: Experiment, plan: Plan, name: str) -> Capture:
    first, last = begin - plan.rest_before_s, begin + experiment.duration_s + plan.rest_after_s
    within = (samples.time_s >= first) & (samples.time_s <= last)
    rows = np.column_stack([samples.time_s[within], samples.acceleration[within]])
    if len(rows) < 2:
        raise MeasurementError(log.source, [f"It holds no accelerations of {name}: the logger was started too late."])
    table = Table(("time", "x", "y", "z"), rows, np.arange(1, len(rows) + 1), {})
    lost = int(((samples.lost_at_s >= first) & (samples.lost_at_s <= last)).sum())
    return make_capture(log.source, table, rows[:, 0], rows[:, 1:], name=name, clock="log", overflows=lost)


# The command


def _played(
    log: MotionLog, begin: float, experiment: Experiment, plan: Plan, kinematics: Kinematics
) -> tuple[Commanded | None, str]:
    """Return the command from the steps where they differ from the plan, and a sentence; None: they do not."""
    steppers = next(([log.steps[n] for n in names] for names in STEPPERS if all(n in log.steps for n in names)), None)
    if steppers is None:
        return None, "the log holds no steps, so nobody can tell whether the input shaper was on."
    t = np.arange(-plan.rest_before_s, experiment.duration_s + plan.rest_after_s, 1 / RATE_HZ)
    planned = kinematics.inverse(experiment.motion.nozzle(t)) @ kinematics.motors.T
    done = np.column_stack([_position(each, begin + t, planned[:, i]) for i, each in enumerate(steppers)])
    steps = np.array([each.step_mm for each in steppers])
    moving = (t >= 0) & (t <= experiment.duration_s)
    apart = np.sqrt((((done - planned)[moving] / steps) ** 2).mean(axis=0))
    if apart.max() <= MOST_STEPS:
        return None, ""
    smooth = butter(2, SMOOTH_HZ, fs=RATE_HZ, output="sos")
    rounded = sosfiltfilt(smooth, done - done[0], axis=0) + done[0]
    nozzle = kinematics.forward(rounded @ np.linalg.inv(kinematics.motors).T)
    end = float(t[-1])
    return (
        Played(CubicSpline(t, nozzle), float(t[0]), end, experiment.duration_s),
        f"the motors differ from the plan by up to {apart.max():.0f} steps rms: the input shaper was on. What the "
        "motors did is taken for the command.",
    )


def _position(steps: Steps, t: FloatArray, planned: FloatArray) -> FloatArray:
    """Return where a motor is commanded to be at print times (k,), mm; the plan (k,) says where it rests.

    A step is made when the command crosses half a step. From which height the firmware counts is not known: shapers do
    not delay on the whole, so on the average the motor is where the plan has it.
    """
    within = slice(*np.searchsorted(steps.time_s, [t[0], t[-1]]).tolist())
    knots = steps.time_s[within]
    if len(knots) < 2:
        return np.full(len(t), planned[0])
    way = np.sign(np.diff(steps.position_mm, prepend=steps.position_mm[0]))
    crossing = (steps.position_mm - 0.5 * way * steps.step_mm)[within]
    before, after = max(float(t[0]), knots[0] - SETTLES_S), min(float(t[-1]), knots[-1] + SETTLES_S)
    inside = (t >= knots[0]) & (t <= knots[-1])
    crossing = crossing - np.mean((np.interp(t, knots, crossing) - planned)[inside])
    return np.interp(t, [before, *knots, after], [planned[0], *crossing, planned[-1]])


# The configuration


def differences(log: MotionLog, machine: Machine) -> list[str]:
    """Say where the printer's configuration contradicts the machine file."""
    settings = log.settings
    if not settings:
        return ["there is no index beside the log, so the printer's configuration cannot be compared."]
    sentences = []
    steps = machine.steps.per_motor
    for names in STEPPERS:
        for name, ours in zip(names, steps.tolist(), strict=True):
            theirs = _steps_per_mm(settings.get(name, {}))
            if theirs is not None and abs(theirs / ours - 1.0) > 1e-3:
                sentences.append(f"{name}: the configuration has {theirs:.6g} steps/mm, and the machine file {ours:g}.")
    arms = getattr(machine.kinematics, "arm_lengths_mm", None)
    for name, ours in zip(STEPPERS[0], () if arms is None else np.asarray(arms).tolist(), strict=False):
        theirs = settings.get(name, {}).get("arm_length", settings.get(STEPPERS[0][0], {}).get("arm_length"))
        if theirs is not None and abs(float(theirs) - ours) > 0.5:
            sentences.append(
                f"{name}: the arm is {float(theirs):g} mm in the configuration, {ours:g} in the machine file."
            )
    return sentences


def _steps_per_mm(section: object) -> float | None:
    if not isinstance(section, dict) or not {"rotation_distance", "microsteps"} <= set(section):
        return None
    full = float(section.get("full_steps_per_rotation", 200))
    geared = np.prod([a / b for a, b in section.get("gear_ratio") or []])
    return float(full * float(section["microsteps"]) * geared / float(section["rotation_distance"]))
