"""What flows along a plan: the closed form of a ramp, and the loop of the tests' own extruder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.firmware.program import plan_program
from ffcomp.report.show import show_figure
from ffcomp.simulation.forecast import NO_FORECAST
from ffcomp.simulation.preview import STEP_S, flow_of, preview
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Pressure
from tests.support.extruder import flowing
from tests.unit.ffcomp.compensation.test_program import FREE, written

MACHINE = load_machine("kossel")
LINE = b"G90\nM83\nM204 S3000\nG1 X-40 Y0 Z5 F9000\nG1 E-3 F1200\nG1 E3\nG1 X40 Y0 E2.64 F6000\n"


@pytest.mark.parametrize("pressure", [Pressure(0.05), Pressure(0.05, 0.7, firmware_advance_s=0.02)])
def test_the_flow_is_that_of_one_state(pressure: Pressure) -> None:
    plan = plan_program(read_program(LINE, "line"), MACHINE).trajectory
    found = flow_of(plan, pressure)
    assert found.pushed.min() > -0.1  # retractions are left out
    by_motor = found.pushed + pressure.firmware_advance_s * np.gradient(found.pushed, STEP_S)
    own = flowing(np.cumsum(by_motor) * STEP_S, pressure, STEP_S)
    assert np.abs(found.flows - np.convolve(own, np.ones(16) / 16, mode="same")).max() < 0.05
    assert found.flows.max() == pytest.approx(3.3, rel=0.15)
    assert np.sum(found.flows) * STEP_S == pytest.approx(2.64, rel=0.05)


def test_show_draws_the_flow_where_the_machine_file_states_the_pressure() -> None:
    file = written(FREE)
    machine = load_machine("mp-delta-pro")
    with_flow = preview(file.text, "squares", replace(machine, pressure=FREE))
    without = preview(file.text, "squares", machine)
    assert without.flows is None and with_flow.flows is not None
    drawn = [show_figure(each, NO_FORECAST, "squares") for each in (without, with_flow)]
    labels = [[axes.get_ylabel() for axes in figure.axes] for figure in drawn]
    assert ["filament, mm/s" in each for each in labels] == [False, True]
