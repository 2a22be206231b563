"""Our steps are the real Kalico host's, where the sample prints begin: as many, the same ways, at the same times.

Runs where KALICO_PYTHON names the python of an environment with Kalico in it; see validation/kalico.py.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.trajectory import Trajectory
from ffcomp.steps.archive import MotorSteps, read_steps
from ffcomp.steps.sink import Board, StepSink
from gcode.reader import read_program
from models.arrays import FloatArray
from models.machine import Steps
from tests.support.knots import trajectory_knots
from tests.support.machines import host_machine
from validation import kalico
from validation.judge import HOST_KNOWS

pytestmark = pytest.mark.kalico

CLOCK_HZ = 50e6  # of the host's board
BOARD = Board(extruder_steps_per_mm=3200 / 22.6789, clock_hz=CLOCK_HZ)
LIMITS = PlannerLimits(
    velocity_mm_per_s=300.0,
    acceleration_mm_per_s2=3000.0,
    delta=DeltaSlowZones(kalico.RADIUS_MM, kalico.ARM_LENGTH_MM, kalico.HALF_STEP_MM),
)
EXACT_S, HOSTS_OWN_S = 1e-9, 25e-6  # how much too early the host may send a step
STEPPERS = {"a": 0, "b": 3, "c": 6, "e": 9}  # as the host numbers them: three numbers a stepper
LINES = 250
START_Z_MM = kalico.START_MM[2]
PRINTS = ("ringing_tower", "far_star")


@cache
def gcode(name: str) -> bytes:
    lines = (Path(__file__).parents[4] / "sample_prints" / f"{name}.gcode").read_bytes().splitlines(keepends=True)
    return b"".join(line for line in lines[:LINES] if HOST_KNOWS.match(line))


@cache
def plan(name: str) -> Trajectory:
    program = read_program(gcode(name), start=kalico.START_MM, flavor="klipper")
    stops, waits = stops_and_waits(program)
    return plan_moves(program.moves, LIMITS, stop_before=stops, wait_before=waits)


@cache
def ours(name: str, error_s: float | None) -> dict[str, MotorSteps]:
    machine = replace(host_machine(), steps=Steps(0.5 / kalico.HALF_STEP_MM))
    with tempfile.TemporaryDirectory() as folder:
        sink = StepSink(machine, BOARD, Path(folder, "steps"), error_s)
        for knots in trajectory_knots(plan(name)):
            sink.knots(knots)
        sink.finish()
        return read_steps(Path(folder, "steps"))


@cache
def hosts(name: str, error_s: float) -> dict[str, tuple[FloatArray, FloatArray]]:
    """When each motor steps, (n,) s on the plan's clock, and which way, (n,) ±1."""
    return _three(name, error_s, "abc") | _three(name, error_s, "eab")  # the oracle tells of three motors at a time


def _three(name: str, error_s: float, motors: str) -> dict[str, tuple[FloatArray, FloatArray]]:
    with tempfile.TemporaryDirectory() as work:
        source, out = Path(work, "x.gcode"), Path(work, "out.npz")
        source.write_bytes(kalico._LEAD_IN + gcode(name))
        numbers = [str(STEPPERS[motor]) for motor in motors]
        options = ["--extruder=2", f"--max-stepper-error={error_s}", "--oids", *numbers]
        places = ["--kalico-python", kalico._python(), str(source), "-o", str(out), "--work", work]
        kalico._run([*places, *options])
        with np.load(out) as host:
            begin_s = _begin(host["moves"][kalico._LEAD_IN_MOVES, 0] - host["t_start"], name)
            found = [(host[f"step_t_{k}"] - begin_s, host[f"step_pos_{k}"]) for k in "abc"]
    return {motor: _after_zero(*each) for motor, each in zip(motors, found, strict=True)}


def _begin(first_travel_s: float, name: str) -> float:
    """When the plan begins on the host's clock, which knows of moves of the nozzle only."""
    travels = plan(name).direction[:, :3].any(axis=1)
    return first_travel_s - float(plan(name).start_t[travels][0])


def _after_zero(t: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Without what leads in; a motor that did nothing then begins at the towers' height."""
    at_start = START_Z_MM + np.sqrt(kalico.ARM_LENGTH_MM**2 - kalico.RADIUS_MM**2)
    way = np.sign(np.diff(height, prepend=at_start))
    return t[t > 0.0], way[t > 0.0]


@pytest.mark.parametrize("motor", list(STEPPERS))
@pytest.mark.parametrize("name", PRINTS)
def test_every_step_is_the_hosts(name: str, motor: str) -> None:
    """To 0.1 µs: a tick is 0.02. On the whole prints 0.03 was measured, and 0.25 for one step of filament."""
    (t, way), steps = hosts(name, EXACT_S)[motor], ours(name, None)[motor]
    np.testing.assert_array_equal(steps.direction, way)
    assert len(t) > 300
    assert np.abs(steps.time_s - t).max() < 1e-7


@pytest.mark.parametrize("motor", list(STEPPERS))
def test_rows_are_no_worse_than_the_hosts(motor: str) -> None:
    """The host's steps are up to 25 µs early, ours within 12.5 µs: never farther apart than both together."""
    (t, way), steps = hosts("ringing_tower", HOSTS_OWN_S)[motor], ours("ringing_tower", HOSTS_OWN_S / 2)[motor]
    exact = ours("ringing_tower", None)[motor]
    np.testing.assert_array_equal(steps.direction, way)
    late = steps.time_s - t
    assert late.min() > -HOSTS_OWN_S / 2 - 1e-7 and late.max() < 1.5 * HOSTS_OWN_S + 1e-7
    assert np.abs(steps.time_s - exact.time_s).max() <= HOSTS_OWN_S / 2 + 1e-9
    assert np.abs(steps.time_s - exact.time_s).max() < np.abs(t - exact.time_s).max()
