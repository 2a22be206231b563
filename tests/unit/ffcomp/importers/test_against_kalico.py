"""An imported configuration moves as the real Kalico host moves with the very same text.

Runs where KALICO_PYTHON names the python of an environment with Kalico in it; see validation/kalico.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ffcomp.planner.limits import planner_limits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.trajectory import Trajectory
from gcode.reader import read_program
from models.machine import Machine
from tests.support.configs import SAVED, imported, written
from validation import kalico

pytestmark = pytest.mark.kalico

# Towers that differ in arm and angle. The host must take B's angle from the saved block, and A's from above it.
CONFIG = (
    "[printer]\nkinematics: delta\nmax_velocity: 200\nmax_accel: 2500\nmax_z_velocity: 40\nmax_z_accel: 900\n"
    "square_corner_velocity: 8\ndelta_radius: 120.5\nprint_radius: 130\n"
    "[stepper_a]\nmicrosteps: 16\nrotation_distance: 40\narm_length: 262\nangle: 208\nposition_endstop: 320\n"
    "[stepper_b]\nmicrosteps: 16\nrotation_distance: 40\narm_length: 267.5\n"
    "[stepper_c]\nmicrosteps: 16\nrotation_distance: 40\narm_length: 258.25\nangle: 93.5\n"
    + SAVED
    + "#*# [stepper_a]\n#*# angle = 211.000000\n#*#\n#*# [stepper_b]\n#*# angle = 326.500000\n"
)
STEP_MM = 40.0 / (200 * 16)
GCODE = (
    b"G1 X30 Y10 F9000\nG1 X60 Y-40 F12000\nG1 X60 Y60\nG1 X-20 Z25 F6000\nG1 X-90 Y20 Z24\nG1 X-118 Y20 F12000\n"
    b"G1 X0 Y0 Z12\nG1 Z30 F18000\n"
)


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return imported(written(tmp_path_factory.mktemp("config"), CONFIG, "printer.cfg"))


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    path = written(tmp_path_factory.mktemp("host"), CONFIG, "printer.cfg")
    return kalico.kalico_plan(GCODE, extra_cfg=str(path), max_stepper_error=1e-9)


def our_plan(machine: Machine) -> Trajectory:
    program = read_program(GCODE, start=kalico.START_MM, flavor="klipper")
    stops, waits = stops_and_waits(program)
    return plan_moves(program.moves, planner_limits(machine), stop_before=stops, wait_before=waits)


def test_the_plan_is_the_hosts(machine: Machine, host: dict[str, Any]) -> None:
    """Speeds, accelerations, corners, Z, and the zones near the rim where a delta is slowed down."""
    ours = our_plan(machine)
    assert ours.start_t[-1] + ours.duration[-1] - ours.start_t[0] == pytest.approx(host["print_s"], abs=1e-9)
    assert np.abs(ours.position(host["t"] + ours.start_t[0])[:, :3] - host["xyz"]).max() < 1e-9


@pytest.mark.parametrize(("column", "tower"), [*enumerate("abc")])
def test_the_carriages_are_the_hosts(column: int, tower: str, machine: Machine, host: dict[str, Any]) -> None:
    """Each step comes half a step before the height that it goes to, as this host makes steps."""
    heights = machine.kinematics.inverse(kalico.sample(host["moves"], host[f"step_t_{tower}"]))[:, column]
    steps = np.diff(host[f"step_pos_{tower}"])
    crossings = np.diff(host[f"step_pos_{tower}"] - 0.5 * np.sign(np.r_[steps[0], steps]) * STEP_MM)
    assert len(steps) > 5000
    assert np.abs(np.cumsum(crossings) - (heights[1:] - heights[0])).max() < 1e-5
