"""The written file as Marlin's queue plays it, in whole steps, on plants that share no equation with ffcomp."""

from __future__ import annotations

import pytest

from ffcomp.compensation.job import Job, Options
from ffcomp.compensation.request import CompensateOptions
from ffcomp.planner.program import plan_program
from models.file import load_machine
from studies.marlin import judge, read


@pytest.mark.parametrize(("case", "better"), [("tower", 3.0), ("star", 3.0)])
def test_marlin_leaves_what_is_predicted(case: str, better: float) -> None:
    """A cartesian printer, and a delta far from its centre: the contour error's p99 within 1.3 times the prediction."""
    (_, before, _), (_, after, predicted) = judge(case, 12.0)
    assert after.p99_um < 1.3 * predicted.contour_p99_um
    assert better * after.rms_um < before.rms_um
    assert after.seconds == pytest.approx(before.seconds, rel=0.03)


@pytest.mark.parametrize("name", ["prusa-mk3s", "ender-3"])
def test_the_stated_time_is_that_of_the_queue(name: str) -> None:
    """At squares with z-hops: early segments count as well as late ones, and a lift before a retraction ends fast."""
    lines = ["G90", "M83", "G28", "G1 X60 Y60 Z0.3 F6000"]
    for i in range(12):
        x, y = 60 + 37 * i % 80, 60 + 23 * i % 80
        lines += ["G1 E-0.8 F2100", "G1 Z0.7 F600", f"G1 X{x} Y{y} F7200", "G1 Z0.3 F600", "G1 E0.8 F2100"]
        lines += [f"G1 X{x + dx} Y{y + dy} E0.5 F3000" for dx, dy in ((12, 0), (12, 12), (0, 12), (0, 0))]
    machine = load_machine(name)
    options = Options.of(CompensateOptions(flavor="marlin"), machine)
    written = Job("\n".join(lines).encode(), "squares", machine, options).lines()
    data = b"".join(written)
    stated = written.value.statistics.print_time_s
    assert stated == pytest.approx(plan_program(read(data, machine), machine).trajectory.end_t, rel=6e-3)
