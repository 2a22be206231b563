"""Waiting until what the firmware moves by itself has stopped ringing."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from ffcomp.compensation.plan import RESIDUAL_MM, ringing_s, settling_waits
from ffcomp.compensation.statistics import Amount, Place, Shares, of_raw
from ffcomp.firmware.program import PlannedProgram, plan_program, planner_of, raw_durations
from ffcomp.numerics.serialise import to_json
from gcode.reader import read_program
from models.file import load_machine
from tests.support.compensated import job

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


# ---- job ----


def test_changes_of_filament_take_what_the_slicer_says() -> None:
    """A print of an AMS of 2 h 4 min said 1 h 3 min: its 68 changes took no time."""
    square = "G1 X0 Y0 Z5 F6000\nG1 X20 Y0 E1\nG1 X20 Y20 E1\nG1 X0 Y0 E1\n"
    settings = "; machine_load_filament_time = 25\n; machine_unload_filament_time = 29\n"
    text = f"M73 P0 R9\nM83\nG28\nT0\n{square}T1\n{square}T1\nT255\nM73 P50 R5\nT0\n{square}{settings}"
    lines = job(text.encode(), load_machine("mp-delta-pro"), flavor="marlin", predict=False).lines()
    written = b"".join(lines).decode()
    numbers = lines.value.statistics
    assert 108.0 < numbers.original_print_time_s < 118.0
    assert numbers.print_time_s == pytest.approx(numbers.original_print_time_s, abs=2.0)
    assert re.findall(r"^M73 .*", written, re.MULTILINE) == ["M73 P0 R2", "M73 P50 R1"]


# ---- statistics ----


HOME = (0.0, 0.0, 5.0)


def test_parts_add_up_by_place_and_command() -> None:
    text = "M83\nG1 X10 E1 F600\nMACRO_A\nG1 X20 E1\nG1 Y5\nMACRO_B\nG1 X0 Y0 E9\nMACRO_A\nG1 X5 Y5\n"
    events = read_program(text.encode(), start=HOME).events
    first, second = of_raw(events[:3], {}).shares, of_raw(events[3:], {}).shares
    shares = Shares(Amount(10.0, 1.0)) + first + second
    lost = {place: (part.path_mm, part.filament_mm) for place, part in shares.left.items()}
    way = 5.0**2 * 17  # 20, 5 and back to 0, 0
    assert lost[Place(3, "MACRO_A")] == pytest.approx((15.0, 1.0))
    assert lost[Place(8, "MACRO_A")] == pytest.approx((50.0**0.5, 0.0))
    assert lost[Place(6, "MACRO_B")] == pytest.approx((way**0.5, 9.0))
    told = {each["command"]: each for each in to_json(shares.by_cause)}
    assert (told["MACRO_A"]["line"], told["MACRO_A"]["places"], told["MACRO_A"]["worst_line"]) == (3, 2, 3)
    assert told["MACRO_A"]["path_mm"] == pytest.approx(15.0 + 50.0**0.5)
    assert shares.filament == pytest.approx(1 / 11)
    assert shares.path == pytest.approx(10 / (25 + 50**0.5 + way**0.5))
