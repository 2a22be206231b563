"""The plan is the real Kalico host's, on a real file for a delta and on random programs.

Runs where KALICO_PYTHON names the python of an environment with Kalico in it; see validation/kalico.py.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.trajectory import Trajectory
from gcode.reader import read_program
from tests.support.data import real
from tests.support.programs import random_program
from validation import kalico

MOTION = re.compile(rb"\s*(G[0-4]|G9[0-2]|M82|M83|M204|SET_VELOCITY_LIMIT)\b", re.IGNORECASE)
STEP_MM = 40.0 / 200  # whole steps: the host has far fewer to write than with microsteps, the plan is the same

pytestmark = pytest.mark.kalico

LINES = 3_000  # of a file: the host takes its time


def motion_only(name: str) -> bytes:
    """The file without what the oracle's bare printer does not know: heating, homing, fans."""
    return b"\n".join(line for line in real(name).splitlines()[:LINES] if MOTION.match(line)) + b"\n"


def our_plan(gcode: bytes, limits: PlannerLimits) -> Trajectory:
    program = read_program(gcode, start=kalico.START_MM)
    stops, waits = stops_and_waits(program)
    return plan_moves(program.moves, limits, stop_before=stops, wait_before=waits)


def firmware(**limits: float) -> PlannerLimits:
    reach = DeltaSlowZones(kalico.RADIUS_MM, kalico.ARM_LENGTH_MM, STEP_MM / 2)
    return PlannerLimits(velocity_mm_per_s=300.0, acceleration_mm_per_s2=3000.0, delta=reach, **limits)


def assert_same_motion(gcode: bytes, limits: PlannerLimits, **options: float) -> None:
    theirs, ours = kalico.kalico_plan(gcode, microsteps=1, **options), our_plan(gcode, limits)
    travels = np.flatnonzero(ours.direction[:, :3].any(axis=1))
    assert len(travels) == len(theirs["moves"])
    start = ours.start_t[travels[0]]
    end = ours.start_t[travels[-1]] + ours.duration[travels[-1]]
    assert end - start == pytest.approx(theirs["print_s"], abs=1e-6)
    assert np.abs(ours.start_t[travels] - start - theirs["moves"][:, 0]).max() < 1e-6
    assert np.abs(ours.position(theirs["t"] + start)[:, :3] - theirs["xyz"]).max() < 1e-6


def test_a_real_file_for_a_delta() -> None:
    assert_same_motion(motion_only("kossel_mks-pwc.gcode"), firmware())


def test_a_random_program() -> None:
    """Short pieces, reversals, retractions, Z, the rim, dwells, limits that the file changes and those of the host."""
    limits = firmware(z_velocity_mm_per_s=15.0, square_corner_velocity_mm_per_s=0.0, minimum_cruise_ratio=0.0)
    assert_same_motion(random_program(3, 90), limits, max_z_velocity=15.0, scv=0.0, mcr=0.0)


def test_the_oracles_steps_are_on_the_clock_of_its_plan() -> None:
    """Each tower's height after a step is the inverse kinematics of the plan then, to less than one step."""
    theirs = kalico.kalico_plan(b"G1 X30 Y10 F6000\nG4 P100\nG1 X-20 Z12\n", microsteps=1)
    for angle, tower in ((210, "a"), (330, "b"), (90, "c")):
        xyz = kalico.sample(theirs["moves"], theirs[f"step_t_{tower}"])
        foot = kalico.RADIUS_MM * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        height = xyz[:, 2] + np.sqrt(kalico.ARM_LENGTH_MM**2 - ((foot - xyz[:, :2]) ** 2).sum(axis=1))
        assert len(height) > 30
        assert np.abs(theirs[f"step_pos_{tower}"] - height).max() < STEP_MM
