"""A simulated extruder of one state: the flow before and after, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.reference import Lead, lead_of
from gcode.reader import read_program
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Pressure
from tests.support.extruder import flowing

MACHINE = load_machine("kossel")
TAU, A, RATIO = 0.05, 3000.0, 0.033
FREE = Pressure(TAU, corner_velocity_mm_per_s=1e3)  # an extruder that follows at once
LINE = b"G90\nM83\nM204 S3000\nG1 X-40 Y0 Z5 F9000\nG1 X40 Y0 E%.4f F6000\n" % (80 * RATIO)
STEP_S = 1e-4


def plan(text: bytes = LINE) -> PlannedProgram:
    return plan_program(read_program(text, "line", flavor="klipper"), MACHINE)


def command(planned: PlannedProgram, lead: Lead, knots_t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return even times, and the filament that is pushed then if segments run evenly from knot to knot."""
    section = planned.sections[-1]
    t = np.arange(knots_t[0], knots_t[-1], STEP_S)
    path = planned.trajectory.position(np.clip(knots_t, section.begin_t, np.nextafter(section.end_t, 0)))[:, 3]
    return t, np.interp(t, knots_t, path + lead.mm)


def knots(planned: PlannedProgram, segment_s: float = 0.004) -> FloatArray:
    section = planned.sections[-1]
    return section.begin_t - 0.004 + segment_s * np.arange(int((section.end_t - section.begin_t) / segment_s) + 3)


def wanted(planned: PlannedProgram, t: FloatArray) -> FloatArray:
    section = planned.sections[-1]
    e = planned.trajectory.position(np.clip(t, section.begin_t, np.nextafter(section.end_t, 0)))[:, 3]
    return np.gradient(e, t)


@pytest.mark.parametrize("exponent", [1.0, 0.6])
def test_what_is_compressed_and_what_flows_are_each_others_inverse(exponent: float) -> None:
    pressure, v = Pressure(TAU, exponent), np.array([0.0, 1e-4, 0.01, 0.5, 2.0, 9.0])
    assert pressure.flow(pressure.compressed(v)) == pytest.approx(v)
    assert pressure.compressed(np.array([2.0]))[0] == pytest.approx(TAU * 2.0)  # the reference


def test_without_a_lead_the_flow_lags_as_the_closed_form_says() -> None:
    planned = plan()
    at = knots(planned, 5e-4)
    t, pushed = command(planned, Lead(np.zeros(len(at)), 1.0), at)
    ramp = (t > planned.sections[-1].begin_t) & (t < planned.sections[-1].begin_t + 100.0 / A - 1e-3)
    missing = (wanted(planned, t) - flowing(pushed, FREE, STEP_S))[ramp]
    since = t[ramp] - planned.sections[-1].begin_t
    assert missing == pytest.approx(RATIO * A * TAU * (1 - np.exp(-since / TAU)), abs=0.06)


@pytest.mark.parametrize("pressure", [FREE, replace(FREE, flow_exponent=0.7)])
def test_with_the_lead_the_flow_is_the_plans(pressure: Pressure) -> None:
    planned = plan()
    at = knots(planned)
    section = planned.sections[-1]
    lead = lead_of(planned.trajectory, section.begin_t, section.end_t, at, pressure)
    assert lead.share == 1.0 and lead.mm[0] == lead.mm[-1] == 0.0
    errors = []
    for mm in (np.zeros(len(at)), lead.mm):
        t, pushed = command(planned, Lead(mm, 1.0), at)
        errors.append(float(np.sqrt(np.mean((wanted(planned, t) - flowing(pushed, pressure, STEP_S)) ** 2))))
    assert errors[1] < 0.12 * errors[0]


def test_a_firmware_that_does_the_same_is_left_alone() -> None:
    planned, section = plan(), plan().sections[-1]
    same = replace(FREE, firmware_advance_s=TAU)
    assert np.allclose(lead_of(planned.trajectory, section.begin_t, section.end_t, knots(planned), same).mm, 0.0)
    less = replace(FREE, firmware_advance_s=0.6 * TAU)
    at = knots(planned, 1e-3)
    lead = lead_of(planned.trajectory, section.begin_t, section.end_t, at, less)
    t, e = command(planned, lead, at)
    pushed = e + less.firmware_advance_s * np.gradient(e, t)
    far = (t > section.begin_t + 0.01) & (t < section.end_t - 0.01)
    assert np.abs(wanted(planned, t) - flowing(pushed, less, STEP_S))[far].max() < 0.15 * RATIO * A * TAU


def test_where_the_extruder_cannot_follow_less_is_written() -> None:
    planned, section = plan(), plan().sections[-1]
    slow = replace(FREE, corner_velocity_mm_per_s=0.2)
    lead = lead_of(planned.trajectory, section.begin_t, section.end_t, knots(planned), slow)
    free = lead_of(planned.trajectory, section.begin_t, section.end_t, knots(planned), FREE)
    assert lead.share < 0.9 and np.abs(lead.mm).max() < 0.9 * np.abs(free.mm).max()
