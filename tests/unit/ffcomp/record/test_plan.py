"""The planned recording: short, at several places, loud enough for microsteps, and exactly what its G-code says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.errors import LimitsError
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.record.gcode_writer import Recorder, gcode_lines
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Plan, load_plan, save_plan
from gcode.reader import read_program
from models.machine import Machine


@pytest.fixture(scope="module")
def plan(machine: Machine) -> Plan:
    return make_plan(machine, Request(seconds=2.0))


def test_the_json_file_holds_the_command(plan: Plan, tmp_path: Path) -> None:
    save_plan(plan, tmp_path / "moves.json")
    again = load_plan(tmp_path / "moves.json")
    assert (again.machine_sha256, again.repeats) == (plan.machine_sha256, plan.repeats)
    for a, b in zip(plan.experiments, again.experiments, strict=True):
        t = np.linspace(-0.1, a.duration_s + 0.1, 999)
        np.testing.assert_array_equal(a.motion.nozzle(t), b.motion.nozzle(t))


def text_of(plan: Plan, machine: Machine, flavor: str, shaper: tuple[str, ...] | None = None) -> str:
    return b"".join(gcode_lines(plan, machine, Recorder(flavor, None, shaper))).decode()


def test_the_gcode_is_the_command(plan: Plan, machine: Machine) -> None:
    """Read back and planned with the limits that the file sets, the moves of each execution take their time."""
    program = read_program(text_of(plan, machine, "klipper").encode(), "moves.gcode")
    stops, waits = stops_and_waits(program)
    whole = plan_moves(program.moves, PlannerLimits(300.0, 10000.0, 5.0), stop_before=stops, wait_before=waits)
    rests = np.flatnonzero(waits > 0.9)  # a second before each execution
    assert len(rests) == 24
    for first, (experiment, _) in zip(rests.tolist(), plan.runs(), strict=True):
        n = len(experiment.motion.speed)
        begin = whole.start_t[first]
        t = np.linspace(0.0, experiment.duration_s, 500)
        np.testing.assert_allclose(whole.position(begin + t)[:, :3], experiment.motion.nozzle(t), atol=1e-6)
        assert whole.start_t[first + n - 1] + whole.duration[first + n - 1] - begin == pytest.approx(
            experiment.duration_s, abs=1e-7
        )


@pytest.mark.parametrize(
    ("flavor", "off", "on"),
    [
        (
            "klipper",
            "SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0",
            "SET_INPUT_SHAPER SHAPER_FREQ_X=47 SHAPER_TYPE_X=ei SHAPER_FREQ_Y=50.2",
        ),
        ("marlin", "M593 F0", "M593 X F47 D0.1"),
        ("reprapfirmware", 'M593 P"none"', "M593 P{var.ffcompShaper} F{var.ffcompFrequency} S{var.ffcompDamping}"),
    ],
)
def test_the_shaper_is_switched_off_and_on_again(plan: Plan, machine: Machine, flavor: str, off: str, on: str) -> None:
    text = text_of(plan, machine, flavor, (on,))
    first_move = text.index("\nG1 ")
    assert text.index(f"\n{off}\n") < first_move < text.rindex("\nG1 ") < text.index(f"\n{on}\n")
    assert off not in text_of(plan, machine, flavor, ()), "the printer has no shaper"


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (Request(places_mm=[(0, 0), (20, 0)]), "20 mm apart; places are at least 40 mm apart"),
        (Request(places_mm=[(200, 0)]), "The place 200,0 reaches 200.0 mm"),
        (Request(places_mm=[(0, 130)]), "ffcomp-.* mm farther in"),
        (Request(seconds=20.0), "The file would take"),
        (Request(acceleration_mm_per_s2=1e5), "is more than the machine's limits allow"),
    ],
)
def test_what_cannot_be_planned_says_what_would_fit(machine: Machine, request_: Request, words: str) -> None:
    with pytest.raises(LimitsError, match=words):
        make_plan(machine, request_)
