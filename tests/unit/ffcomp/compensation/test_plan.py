"""Waiting until what the firmware moves by itself has stopped ringing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ffcomp.compensation.plan import RESIDUAL_MM, ringing_s, settling_waits
from ffcomp.firmware.program import PlannedProgram, plan_program, planner_of, raw_durations
from gcode.reader import read_program
from models.file import load_machine

VORON = load_machine("voron-300")
XY = np.array([100.0, 100.0])
HEAD = "M83\nG28\nG1 Z5 F600\nG1 X100 Y100 F6000\n"


def waits(text: str) -> list[float]:
    planned = plan_program(read_program(text.encode(), flavor="klipper"), VORON)
    raw_s = raw_durations(planned.program.events, planner_of(planned.program, VORON))
    return list(settling_waits(planned, VORON, raw_s, planned.sections).values())


def planned_of(text: str) -> PlannedProgram:
    return plan_program(read_program(text.encode(), flavor="klipper"), VORON)


def oscillator(w: float, damping: float, acceleration: float, brake_s: float, rest_s: float) -> float:
    """Integrate x'' = w² (u - x) + 2 ζ w (u' - x') while u brakes to rest and then rests; returns the largest |x - u|
    of the period that follows."""
    h, y, v, largest = 1e-5, 0.0, 0.0, 0.0
    for k in range(round((brake_s + rest_s + 2 * math.pi / w) / h)):
        t = k * h
        a = -acceleration if t < brake_s else 0.0
        v += h * (-w * w * y - 2 * damping * w * v - a)  # y = x - u
        y += h * v
        if t >= brake_s + rest_s:
            largest = max(largest, abs(y))
    return largest


@pytest.mark.parametrize("brake_s", [0.005, 0.0116, 0.02, 0.05])
def test_no_more_is_left_than_stated_by_an_independent_integration(brake_s: float) -> None:
    for axis, acceleration in ((0, 3000.0), (1, 10000.0)):
        (modes,) = VORON.vibration.modes(XY[None])
        mode = int(np.abs(modes.nozzle[:, axis]).argmax())
        w, damping = 2 * math.pi * float(modes.frequencies_hz[mode]), float(modes.damping_ratios[mode])
        rest_s = ringing_s(VORON, XY, acceleration, [axis])
        assert 0.05 < rest_s < 0.5
        assert oscillator(w, damping, acceleration, brake_s, rest_s) < 1.02 * RESIDUAL_MM
        assert oscillator(w, damping, acceleration, brake_s, 0.0) > 2 * RESIDUAL_MM


def test_travel_before_the_extrusion_counts() -> None:
    (whole,) = waits(HEAD + "G1 X120 E1\n")
    assert whole == pytest.approx(ringing_s(VORON, XY, 3000.0, [0, 1, 2]), abs=1e-3)
    travel_s = planned_of(HEAD + "G1 X101\nG4 P1\nG1 X120 E1\n").trajectory.start_t[1]
    (less,) = waits(HEAD + "G1 X101\nG4 P1\nG1 X120 E1\n")
    assert less == pytest.approx(whole - float(travel_s), abs=1e-3)
    assert waits(HEAD + "G1 X250\nG1 X100\nG1 X120 E1\n") == []
    assert waits(HEAD + "G4 P500\nG1 X120 E1\n") == [], "and so does a wait of the file"


def test_only_what_moves_by_itself_is_waited_for() -> None:
    known = HEAD + "G1 X120 E1\n"
    assert len(waits(known + "M106 S255\nM400\nTIMELAPSE_TAKE_FRAME\nG1 X100 E1\n")) == 1
    assert len(waits(known + "PAUSE\nG1 X100 E1\n")) == 2
    assert len(waits(known + "MY_MACRO\nG1 X100 Y100 Z5\nG1 X120 E1\n")) == 2
    assert len(waits(known + "PAUSE\nG1 X100\nPAUSE\nG1 X120 E1\n")) == 2, "nothing is extruded between the two"
