"""Step timings as a command: motors hold their microsteps, and the staircase itself is executed.

A step comes when the command crosses the middle between two microsteps, so the staircase is the command rounded to
them: neither early nor late, no more than half a microstep off.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ffcomp.errors import NothingToDo
from ffcomp.simulate.command import Command, CommandSection, OfTime, ReferencePath
from ffcomp.steps.reader import MOTORS, MotorSteps, StepsError
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.kinematics.base import Kinematics
from models.machine import Machine

REFERENCE = "the path of the steps themselves, with the microsteps smoothed out"
LEAD_S = 0.05  # of rest before the first step
AT_REST_S = 0.02  # a motor that holds a microstep for longer stands in its middle
PATH_SAMPLE_S = 1 / 3200  # of the reference path: 0.1 µm at 10 m/s²


def staircase(motor: MotorSteps, t: FloatArray, step_s: float) -> FloatArray:
    """Return the motor's mean position, (k,) mm, over one step of time about each of the even times t (k,) s.

    A mean keeps the time of every edge; executed with straight lines between rows, nothing comes early or late.
    """
    edges = np.append(t - step_s / 2, t[-1] + step_s / 2)
    first, last = np.searchsorted(motor.time_s, (edges[0], edges[-1]))
    # relative to the first edge, so that no digits are lost
    corners = np.concatenate([[0.0], motor.time_s[first:last] - edges[0], [edges[-1] - edges[0]]])
    level = motor.level_mm[first : last + 1]
    area = np.concatenate([[0.0], np.cumsum((level - level[0]) * np.diff(corners))])
    means: FloatArray = level[0] + np.diff(np.interp(edges - edges[0], corners, area)) / step_s
    return means


def smoothed(motor: MotorSteps, t: FloatArray) -> FloatArray:
    """Return the command, (k,) mm, that the motor's steps stand for, at rising times t (k,) s.

    Known at every step: half-way between two microsteps. In between it passes the middle of the microstep that is
    held, or stays there if that takes long.
    """
    first, last = np.searchsorted(motor.time_s, (t[0], t[-1]))
    part = slice(max(int(first) - 1, 0), int(last) + 1)  # one step more on either side
    crossed = motor.time_s[part]
    level = motor.level_mm[part.start : part.start + len(crossed) + 1]
    if not len(crossed):
        return np.full(len(t), level[0])
    stays = np.minimum(np.diff(crossed) / 2, AT_REST_S)
    before, after = np.append(AT_REST_S, stays), np.append(stays, AT_REST_S)
    times = np.stack([crossed - before, crossed, crossed + after], axis=1).ravel()
    heights = np.stack([level[:-1], (level[:-1] + level[1:]) / 2, level[1:]], axis=1).ravel()
    return np.interp(t, times, heights)


def steps_command(motors: Mapping[str, MotorSteps], machine: Machine, path: str = "") -> Command:
    """Return the steps of a, b, c, from rest to rest, evaluated against the path they stand for.

    Parameters
    ----------
    motors : mapping
        Steps of "a", "b" and "c", and of others.
    machine : Machine
    path : str
        The archive, as the user named it.

    Raises
    ------
    StepsError
        If the carriages begin where the machine's arms cannot join them.
    NothingToDo
        If no carriage steps.
    """
    carriages = [motors[motor] for motor in MOTORS]
    moving = [each.time_s for each in carriages if len(each.time_s)]
    if not moving:
        raise NothingToDo(f"{path or 'The archive'} holds no step of a carriage: nothing to simulate.")
    back = np.linalg.inv(machine.kinematics.motors).T
    _check_start(machine.kinematics, np.array([[each.start_mm for each in carriages]]) @ back, path)
    begin_s = max(min(float(t[0]) for t in moving) - LEAD_S, 0.0)
    end_s = max(float(t[-1]) for t in moving) + AT_REST_S

    def rows(t: FloatArray, step_s: float) -> FloatArray:
        return np.column_stack([staircase(each, t, step_s) for each in carriages]) @ back

    def commanded(t: FloatArray) -> FloatArray:
        return np.column_stack([smoothed(each, t) for each in carriages]) @ back

    reference = _reference(commanded, machine.kinematics)
    return Command([CommandSection(begin_s, end_s, rows, commanded, reference)], "linear", REFERENCE)


def _check_start(kinematics: Kinematics, carriages: FloatArray, path: str) -> None:
    try:
        kinematics.forward(carriages)
    except UnreachableError as error:
        raise StepsError(f"a_start_mm, b_start_mm, c_start_mm: {error}", path=path) from error


def _reference(commanded: OfTime, kinematics: Kinematics) -> ReferencePath:
    compiled = kinematics.compiled()

    def nozzle(t: FloatArray) -> FloatArray:
        return compiled.forward(commanded(t))

    def path(from_s: float, to_s: float) -> tuple[FloatArray, FloatArray]:
        t = np.linspace(from_s, to_s, int(np.ceil((to_s - from_s) / PATH_SAMPLE_S)) + 1)
        return t, nozzle(t)

    return ReferencePath(nozzle, lambda t: t, path)
