"""What a candidate may be in the motion that was recorded, and parameters of no possible printer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.diagnosis.candidates import within_travel
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Candidate, InfeasibleParameters, Parameter
from ffcomp.measurement.recording import Recording
from models.file import load_machine

AMPLITUDE = Parameter("effects.cogging.amplitude_mm", 0.0, 0.01)
PITCH = Parameter("effects.cogging.pitch_mm", 0.2, 0.4, 0.05, 50.0)
GRID = ({PITCH.name: 0.2}, {PITCH.name: 0.8})
COGGING = Candidate("cogging", (AMPLITUDE,), {AMPLITUDE.name: 0.01}, (PITCH,), GRID)


@pytest.mark.parametrize(("travel_mm", "starts", "most"), [(100.0, 2, 50.0), (20.0, 2, 10.0), (1.0, 1, 0.5)])
def test_a_pitch_fits_twice_into_the_travel(travel_mm: float, starts: int, most: float) -> None:
    found = within_travel(replace(COGGING, other=COGGING), travel_mm)
    assert found is not None and found.other is not None
    for each in (found, found.other):
        assert (len(each.grid), each.shapes[0].high) == (starts, most)


def test_arms_too_short_for_the_bed_are_infeasible_and_stop_nothing() -> None:
    t = np.arange(400) / 1600.0
    moving = np.column_stack([0.5 * np.sin(40.0 * t) ** 2, np.zeros(400), np.full(400, 30.0)])
    run = Recording("run.csv", t, moving, "nozzle", {"acc_x": np.sin(40.0 * t)}, {}, np.zeros(400, dtype=np.bool_), {})
    problem = PrinterProblem(load_machine("mp-delta-pro"), [run])
    short = {f"effects.arm_geometry.arm_length_mm[{i}]": -250.0 for i in range(3)}
    impossible, plain = problem.simulate_many([short, {}])
    assert isinstance(impossible, InfeasibleParameters) and "arm" in str(impossible)
    assert not isinstance(plain, InfeasibleParameters) and len(plain) == 1
