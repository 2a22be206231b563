"""Step timings played: the staircase is the command rounded to microsteps, neither early nor late."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.firmware.program import plan_program
from ffcomp.simulation.command import Command, gcode_command, smoothed, staircase
from ffcomp.simulation.playback import ROW_S, play
from ffcomp.simulation.request import SimulateRequest
from ffcomp.simulation.simulation import read_command, simulate_command
from ffcomp.steps.archive import MotorSteps
from gcode.reader import read_program
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Machine
from tests.support.machines import host_machine
from validation import kalico

STEP_MM = 0.0125
CLOCK_HZ = 64_000_000.0
FINE_S = 2e-6  # less than a 16th of a step at 300 mm/s
EXACT_S = 1e-9  # the host may compress its steps, but not move them
MACHINE = load_machine("mp-delta-pro")
SHORT = b"G1 X30 Y12 F9000\nG1 X28 Y30\nG1 X-20 Y-20 Z10.3 F12000\nG4 P100\nG1 X0 Y0 F9000\n"


def steps_of(t: FloatArray, crossed_mm: FloatArray) -> MotorSteps:
    """Steps at the times t (n,) of crossings of half-way heights, from (nearly) zero."""
    order = np.argsort(t, kind="stable")
    t, crossed = t[order], np.rint(crossed_mm[order] / STEP_MM - 0.5)
    levels = np.empty(len(t) + 1)
    levels[0] = 0.0
    for k, low in enumerate(crossed):
        levels[k + 1] = low + 1 if levels[k] == low else low
    return MotorSteps(t, np.diff(levels).astype(np.int8), 0.0, STEP_MM)


def rows_until(end_s: float) -> FloatArray:
    return ROW_S * np.arange(int(end_s / ROW_S))


def sine_steps(amplitude_mm: float, hertz: float, periods: int) -> MotorSteps:
    """Of A sin(2πft), its crossings in closed form."""
    reached = int(amplitude_mm / STEP_MM - 0.5)
    heights = (np.arange(-reached - 1, reached + 1) + 0.5) * STEP_MM
    rising = np.arcsin(heights / amplitude_mm)
    turn = 2 * np.pi * np.arange(periods)[:, None]
    both = np.concatenate([(rising + turn).ravel(), (np.pi - rising + turn).ravel()])
    both, crossed = np.mod(both, 2 * np.pi * periods), np.tile(heights, 2 * periods)
    return steps_of(both / (2 * np.pi * hertz), crossed)


@pytest.mark.parametrize(("amplitude_mm", "hertz"), [(1.0037, 40.0), (0.15, 5.0), (20.0, 2.0)])
def test_a_sine_comes_back_without_delay(amplitude_mm: float, hertz: float) -> None:
    """Half a microstep at most, no offset, and a delay (error against speed, least squares) below a microsecond."""
    motor = sine_steps(amplitude_mm, hertz, 10)
    t = rows_until(10 / hertz)
    omega = 2 * np.pi * hertz
    bow = 1 - np.sinc(hertz * ROW_S)  # by which the mean of a sine over a row is smaller
    for played in (staircase(motor, t, ROW_S), smoothed(motor, t)):
        error = played - amplitude_mm * np.sin(omega * t)
        speed = amplitude_mm * omega * np.cos(omega * t)
        assert np.abs(error).max() < STEP_MM / 2 + bow * amplitude_mm + 1e-9
        assert abs(error.mean()) < STEP_MM / 100
        assert abs(float(error @ speed) / float(speed @ speed)) < 1e-6


# ---- archives ------------------------------------------------------------------------------------


def archive(command: Command, step_mm: float = STEP_MM) -> dict[str, Any]:
    """The steps of a smooth command, as its carriages cross half-way between microsteps."""
    end_s = command.sections[0].end_s + 0.01
    t = np.arange(0.0, end_s, FINE_S)
    arrays: dict[str, Any] = {"clock_hz": CLOCK_HZ}
    for motor, heights in zip("abc", command.sections[0].actuators(t).T, strict=True):
        level = np.rint((heights - heights[0]) / step_mm)
        at = np.flatnonzero(np.diff(level))
        half = heights[0] + step_mm * (level[at] + level[at + 1]) / 2
        crossed = t[at] + FINE_S * (half - heights[at]) / (heights[at + 1] - heights[at])
        arrays |= {f"{motor}_tick": np.rint(crossed * CLOCK_HZ).astype(np.int64)}
        arrays |= {f"{motor}_direction": np.diff(level)[at].astype(np.int8)}
        arrays |= {f"{motor}_start_mm": heights[0], f"{motor}_step_mm": step_mm}
    return arrays


def planned(machine: Machine = MACHINE) -> Command:
    return gcode_command(plan_program(read_program(SHORT, start=kalico.START_MM, flavor="klipper"), machine), machine)


def saved(folder: Path, arrays: dict[str, Any]) -> Path:
    path = folder / "steps without a suffix"
    with open(path, "wb") as file:
        np.savez(file, **arrays)
    return path


@pytest.fixture(scope="module")
def arrays() -> dict[str, Any]:
    return archive(planned())


def nozzle(command: Command, plant: Machine = MACHINE) -> tuple[FloatArray, FloatArray]:
    pieces = list(play(command, plant, 1600.0))
    return np.concatenate([p.t_s for p in pieces]), np.concatenate([p.nozzle_mm for p in pieces])


def apart_um(steps: Command, whole: Command, plant: Machine = MACHINE) -> FloatArray:
    """How far the nozzle under the steps is from the nozzle under the plan, at each sample of the former."""
    (t, stepped), (plan_t, plan) = nozzle(steps, plant), nozzle(whole, plant)
    inside = t < plan_t[-1]
    at = np.column_stack([np.interp(t[inside], plan_t, column) for column in plan.T])
    return 1e3 * np.linalg.norm(stepped[inside] - at, axis=1)


@pytest.mark.parametrize(("microsteps", "largest_um", "rms_um"), [(1, 24.0, 7.0), (16, 1.5, 0.45)])
def test_a_print_as_steps_moves_the_nozzle_as_its_gcode_does(
    microsteps: int, largest_um: float, rms_um: float, tmp_path: Path
) -> None:
    """What is apart is the microsteps alone (12.5 µm of a carriage, up to twice that of the nozzle): in proportion."""
    whole = planned()
    steps, warnings = read_command(saved(tmp_path, archive(whole, STEP_MM / microsteps)), MACHINE)
    distance = apart_um(steps, whole)
    assert distance.max() < largest_um
    assert np.sqrt(np.mean(distance**2)) < rms_um
    request = SimulateRequest("print.npz", MACHINE)
    stepped, smooth = (simulate_command(request, each, MACHINE, MACHINE).track for each in (steps, whole))
    assert stepped.contour_rms_um == pytest.approx(smooth.contour_rms_um, rel=0.05)
    assert stepped.delay_s == pytest.approx(smooth.delay_s, abs=2e-5)
    assert not warnings


# ---- the real host's steps -----------------------------------------------------------------------


@pytest.mark.kalico
@pytest.mark.parametrize(("microsteps", "largest_um", "rms_um"), [(16, 24.0, 7.0), (256, 1.5, 0.45)])
def test_the_hosts_own_steps_play_our_plan(microsteps: int, largest_um: float, rms_um: float, tmp_path: Path) -> None:
    """As our own steps: what is apart is the microsteps alone."""
    machine = host_machine()
    limits = {"max_velocity": machine.limits.velocity_mm_per_s, "max_accel": machine.limits.acceleration_mm_per_s2}
    corner = machine.limits.square_corner_velocity_mm_per_s
    host = kalico.kalico_plan(SHORT, scv=corner, mcr=0.5, microsteps=microsteps, max_stepper_error=EXACT_S, **limits)
    step_mm = 32 * kalico.HALF_STEP_MM / microsteps
    steps, _ = read_command(saved(tmp_path, host_archive(host, step_mm)), machine)
    distance = apart_um(steps, planned(machine), machine)
    assert distance.max() < largest_um
    assert np.sqrt(np.mean(distance**2)) < rms_um


def host_archive(host: dict[str, Any], step_mm: float) -> dict[str, Any]:
    """The host's step times as an archive. Its towers begin where the planned nozzle does, to half a step."""
    arrays: dict[str, Any] = {"clock_hz": CLOCK_HZ}
    for motor in "abc":
        t, height = host[f"step_t_{motor}"], host[f"step_pos_{motor}"]
        way = np.sign(np.diff(height))
        first = way[0]  # the print begins with moves in one direction
        ways = np.concatenate([[first], way]).astype(np.int8)
        arrays |= {f"{motor}_tick": np.rint(t * CLOCK_HZ).astype(np.int64), f"{motor}_direction": ways}
        arrays |= {f"{motor}_start_mm": height[0] - first * step_mm, f"{motor}_step_mm": step_mm}
    return arrays
