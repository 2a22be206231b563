"""Cartesian and CoreXY machines, end to end: judged by the closed form of their modes, never by the model itself."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from ffcomp.comparison import methods as ours
from ffcomp.compensation.file import compensate_file
from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import contour_error
from ffcomp.simulation.command import Motion, motion_of, path_corners, planned_motion
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine
from tests.support.compensated import plainly
from tests.support.configs import STEPS
from tests.support.klipper_host import EXTRUDER
from validation.judge import HOST_KNOWS
from validation.kalico import kalico_moves

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[2]
STEP_S = 1 / 12800
MODES = {  # frequency Hz, damping ratio, share
    "x": [(58.0, 0.05, 0.85), (93.0, 0.05, 0.15)],
    "y": [(41.0, 0.07, 1.0)],
}
HEAD = """format = "ffcomp-machine/1"
name = "Straight"
[kinematics]
type = "corexy"
x_range_mm = [-150.0, 150.0]
y_range_mm = [-150.0, 150.0]
z_range_mm = [-2.0, 300.0]
[limits]
velocity_mm_per_s = 300.0
acceleration_mm_per_s2 = 5000.0
z_velocity_mm_per_s = 20.0
z_acceleration_mm_per_s2 = 500.0
{limits}
{steps}extruder_steps_per_mm = 415.0
"""

MOTOR = """[{name}]
step_pin: gpio{n}1
dir_pin: gpio{n}2
enable_pin: !gpio{n}3
microsteps: 16
rotation_distance: {turn}
"""
ENDS = "endstop_pin: gpio{n}4\nposition_min: -650\nposition_max: 800\nposition_endstop: -650\n"
HOST = """[force_move]
enable_force_move: True
[printer]
kinematics: corexy
max_velocity: 300
max_accel: 5000
max_z_velocity: 20
max_z_accel: 500
"""
HOST = MOTOR.format(name="extruder", n=4, turn=22.6789) + EXTRUDER + HOST
for n, axis in enumerate("xyz"):
    HOST += (MOTOR + ENDS).format(name=f"stepper_{axis}", n=n or "", turn=8 if axis == "z" else 40)


def machine_text(limits: str = "") -> str:
    return HEAD.format(limits=limits, steps=STEPS) + "".join(_axis(name, found) for name, found in MODES.items())


def _axis(name: str, found: list[tuple[float, float, float]]) -> str:
    columns = zip(("frequency_hz", "damping_ratio", "share"), map(list, zip(*found, strict=True)), strict=True)
    return f"[axes.{name}]\n" + "".join(f"{key} = {values}\n" for key, values in columns)


def made(folder: Path, text: str) -> Path:
    path = folder / "straight.toml"
    path.write_text(text)
    return path


@cache
def print_text(layers: int = 6) -> bytes:
    """The first layers of a sample print."""
    whole = (ROOT / "sample_prints/ringing_tower.gcode").read_bytes()
    return b";LAYER_CHANGE".join(whole.split(b";LAYER_CHANGE")[: layers + 1])


def responded(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """What the modes' sum makes of a motion: t (n,) s, nozzle (n, 3) mm. Exact for a command linear between samples."""
    t = np.arange(motion.begin_t, motion.end_t, STEP_S)
    command = motion.position(t)
    nozzle = command.copy()
    for axis, found in enumerate(MODES.values()):
        begun = command[0, axis]
        nozzle[:, axis] = begun + sum(_filtered(command[:, axis] - begun, *mode) for mode in found)
    return t, nozzle


def _filtered(command: FloatArray, frequency_hz: float, damping: float, share: float) -> FloatArray:
    omega = 2 * np.pi * frequency_hz
    b, a, _ = cont2discrete(([share * omega**2], [1.0, 2 * damping * omega, omega**2]), STEP_S, method="foh")
    return np.asarray(lfilter(b.ravel(), a, command))


def contour_rms_um(planned: PlannedProgram, motion: Motion) -> float:
    t, nozzle = responded(motion)
    counted = slice(int(0.5 / STEP_S), None, 8)
    error = contour_error(*path_corners(planned.trajectory), motion.clock.plan_time(t[counted]), nozzle[counted])
    return 1e3 * float(np.sqrt(np.mean(error**2)))


@pytest.fixture(scope="module")
def corexy(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return load_machine(made(tmp_path_factory.mktemp("corexy"), machine_text()))


def test_a_print_is_far_better_on_the_modes_themselves(corexy: Machine) -> None:
    planned = plan_program(read_program(print_text(), flavor="klipper"), corexy)
    compensated = ours.compensated(planned, InverseModel(corexy, settings_for(corexy)), "klipper")
    segments = ours.segments(compensated, corexy)
    played = motion_of(segments.trajectory, segments.clock(segments.trajectory.start_t))
    before = contour_rms_um(planned, planned_motion(planned.trajectory))
    after = contour_rms_um(planned, played)
    assert before > 20.0
    assert after < 2.5


@pytest.mark.kalico
def test_the_real_host_keeps_the_pace(corexy: Machine) -> None:
    """A cartesian printer whose Z is slow: the host's own plan of both files takes what ours says."""
    planned = plan_program(read_program(print_text(), flavor="klipper"), corexy)
    compensated = ours.compensated(planned, InverseModel(corexy, settings_for(corexy)), "klipper")
    took = []
    for text in (print_text(), compensated.text):
        known = b"".join(line for line in text.splitlines(keepends=True) if HOST_KNOWS.match(line))
        took.append(kalico_moves(HOST, known))
    before, after = (float(moves[-1, 0] + moves[-1, 1:4].sum() - moves[0, 0]) for moves in took)
    assert after == pytest.approx(before, rel=0.01)
    assert len(took[1]) / after <= 300


def test_motors_of_a_corexy_are_held_to_their_limits(tmp_path: Path) -> None:
    """At 45 degrees one motor does all, √2 times as fast as the nozzle."""
    machine = load_machine(made(tmp_path, machine_text(limits="carriage_velocity_mm_per_s = 150.0")))
    inverter = InverseModel(machine, settings_for(machine))
    diagonal = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [1.0, 1.0, 0.0]])
    asked = inverter.limits.demand(diagonal)
    assert asked.velocity[0, :, 0] == pytest.approx([250.0, 0.0, 0.0])
    assert asked.height[1, :, 1] == pytest.approx([2.0, 0.0, 0.0])
    source = tmp_path / "fast.gcode"
    source.write_bytes(b"G1 X0 Y0 Z1 F6000\nG1 X60 Y60 F12000\nG1 X0 Y60\nG1 X60 Y0\n")
    done = compensate_file(source, source.name, machine, plainly(), tmp_path / "out.gcode")
    assert any("velocity" in warning for warning in done.warnings)


@pytest.mark.parametrize("flavor", ["marlin", "reprapfirmware"])
def test_the_limits_of_a_lead_screw_are_never_raised(corexy: Machine, flavor: str) -> None:
    planned = plan_program(read_program(print_text(1), flavor=flavor), corexy)
    text = ours.compensated(planned, InverseModel(corexy, settings_for(corexy)), flavor).text
    limits = re.findall(rb"^(?:M201|M203|M566) .*; ffcomp", text, re.MULTILINE)
    assert limits
    assert not any(b"Z" in line for line in limits)


def test_steps_of_a_corexy_are_those_of_its_two_motors(tmp_path: Path) -> None:
    machine = load_machine(made(tmp_path, machine_text()))
    source, out = tmp_path / "square.gcode", tmp_path / "steps.npz"
    source.write_bytes(b"G1 X0 Y0 Z1 F6000\nG1 X30 Y0 E1 F3000\nG1 X30 Y20\nG1 X0 Y0\n")
    steps = plainly(kind="steps", extruder_steps_per_mm=415.0)
    compensate_file(source, source.name, machine, steps, out)
    with np.load(out) as found:
        motors = {m: (found[f"{m}_direction"], float(found[f"{m}_start_mm"])) for m in "abc"}
    begin, corner = (0.0, 0.0), (30.0, 20.0)
    for name, sign in (("a", 1.0), ("b", -1.0)):
        direction, start = motors[name]
        assert start == pytest.approx(begin[0] + sign * begin[1])
        place = start + np.cumsum(direction) / 80.0
        assert place.max() == pytest.approx(max(30.0, corner[0] + sign * corner[1]), abs=0.5)
        assert abs(place[-1]) < 0.0126
    assert not len(motors["c"][0])
