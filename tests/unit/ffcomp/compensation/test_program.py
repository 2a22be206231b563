"""A compensated file on an extruder of one state: corners do not bulge, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ffcomp.comparison.methods import Compensated, compensated, segments
from ffcomp.compensation.net import fault_of, path_fault
from ffcomp.firmware.program import plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import WHOLE
from ffcomp.inverse.settings import settings_for
from ffcomp.inverse.solve import solve
from gcode.reader import read_program
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Pressure
from tests.support.extruder import flowing
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")
TAU, STEP_S = 0.05, 2.5e-4
FREE = Pressure(TAU, corner_velocity_mm_per_s=20.0)


@cache
def written(pressure: Pressure | None, text: bytes = squares(1)) -> Compensated:
    # the limits that the firmware plans with are the same with and without
    machine = replace(MACHINE, pressure=pressure)
    planned = plan_program(read_program(text, "squares", flavor="klipper"), machine)
    return compensated(planned, InverseModel(machine, settings_for(machine)), "klipper")


def flows(file: Compensated, pressure: Pressure) -> tuple[FloatArray, FloatArray]:
    """Return what should flow and what does, mm/s, at even times."""
    own, original = segments(file, replace(MACHINE, pressure=pressure)), file.planned.trajectory
    plan = own.trajectory
    t = np.arange(plan.start_t[0], plan.end_t, STEP_S)
    pushed = plan.position(t)
    moves = np.any(np.abs(np.diff(pushed[:, :3], axis=0)) > 1e-9, axis=1)
    de = np.diff(pushed[:, 3])
    e = np.concatenate([[0.0], np.cumsum(np.where(moves & (np.abs(de) < 0.05), de, 0.0))])  # without retractions
    if pressure.firmware_advance_s:
        e = e + pressure.firmware_advance_s * np.gradient(e, STEP_S)
    due = own.clock(plan.start_t).plan_time(t)
    should = np.maximum(np.gradient(original.position(due)[:, 3], STEP_S), 0.0)
    travels = np.any(np.abs(np.gradient(original.position(due)[:, :3], axis=0)) > 1e-9, axis=1)
    return np.where(travels, should, 0.0), flowing(e, pressure, STEP_S)


def off(file: Compensated, pressure: Pressure) -> float:
    """Return the rms of what flows too much or too little, as a share of the mean flow."""
    should, does = flows(file, pressure)
    smooth = np.ones(32) / 32  # 8 ms: segments are steps of flow
    error = np.convolve(does - should, smooth, mode="same")
    return float(np.sqrt(np.mean(error[should > 0.0] ** 2)) / should[should > 0.0].mean())


def test_the_flow_follows_the_path() -> None:
    before, after = off(written(None), FREE), off(written(FREE), FREE)
    assert after < 0.35 * before, (before, after)


def test_the_motion_and_the_filament_in_all_stay() -> None:
    usual, ahead = written(None), written(FREE)
    one_segment_a_line_s = 0.004 * 4  # the extruder's jump may ask for a little more time at a line's ends
    assert ahead.statistics.print_time_s == pytest.approx(
        usual.statistics.print_time_s, abs=one_segment_a_line_s + 1e-6
    )
    ends = [
        plan_program(read_program(f.text, "", flavor="klipper"), MACHINE).program.moves.end[-1] for f in (usual, ahead)
    ]
    assert ends[0] == pytest.approx(ends[1], abs=2e-4)
    assert not ahead.statistics.warnings


def test_what_cannot_be_done_is_said() -> None:
    said = " ".join(written(Pressure(TAU)).statistics.warnings)
    assert "of the lead for the hot end's pressure" in said and "extruder.firmware_advance_s" in said
    own = squares(1).replace(b"G21\n", b"G21\nSET_PRESSURE_ADVANCE ADVANCE=0.03\n")
    said = " ".join(written(FREE, own).statistics.warnings)
    assert "line 4" in said and "0.03" in said


# ---- net ----


START = (0.0, 0.0, 0.3)
BUMP = np.exp(-(((np.arange(400) - 60.0) / 12.0) ** 2))[:, None] * np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("off_mm", "why"),
    [(0.0, ""), (0.3, ""), (3.0, "it leaves its path by 3"), (np.nan, "it is not finite")],
)
def test_a_command_far_from_its_path_is_refused(off_mm: float, why: str) -> None:
    machine = load_machine("mp-delta-pro")
    planned = plan_program(read_program(b"G1 X30 F3000\nG1 X30 Y4\n", start=START, flavor="klipper"), machine)
    model, section = InverseModel(machine, settings_for(machine)), planned.sections[0]
    reference, moves = WHOLE.written(planned.trajectory, section, model.settings).reference, planned.program.moves
    vertices = solve(model, reference, machine.equilibrium(np.array(START))).vertices
    found = fault_of(model, moves, reference, vertices - off_mm * BUMP[: len(vertices)])
    assert found.startswith(why) and bool(found) == bool(why)
    assert path_fault(model, reference, vertices - off_mm * BUMP[: len(vertices)], (110, reference.knots)) == (
        why if np.isnan(off_mm) else ""
    )
    assert "off its path" in fault_of(model, moves, reference, vertices + 0.02)
    apart = np.array([[0.0] * 4, [0.1, 0.0, 0.0, 0.0]])
    gap = replace(moves, start=moves.start + apart)
    assert "jumps by 0.1 mm" in fault_of(model, gap, reference, vertices)
