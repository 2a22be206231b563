"""Parameters of no possible printer are told from a failure of the search."""

from __future__ import annotations

import numpy as np

from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import InfeasibleParameters
from ffcomp.measurement.recording import Recording
from models.file import load_machine


def test_arms_too_short_for_the_bed_are_infeasible_and_stop_nothing() -> None:
    t = np.arange(400) / 1600.0
    moving = np.column_stack([0.5 * np.sin(40.0 * t) ** 2, np.zeros(400), np.full(400, 30.0)])
    run = Recording("run.csv", t, moving, "nozzle", {"acc_x": np.sin(40.0 * t)}, {}, np.zeros(400, dtype=np.bool_), {})
    problem = PrinterProblem(load_machine("mp-delta-pro"), [run])
    short = {f"effects.arm_geometry.arm_length_mm[{i}]": -250.0 for i in range(3)}
    impossible, plain = problem.simulate_many([short, {}])
    assert isinstance(impossible, InfeasibleParameters) and "arm" in str(impossible)
    assert not isinstance(plain, InfeasibleParameters) and len(plain) == 1
