"""Marlin's plan, block by block, against what the real Marlin 2.1.2 makes of sixteen programs."""

from __future__ import annotations

import csv
from dataclasses import replace

import pytest

from ffcomp.planner.marlin import MarlinPlan, MarlinPlanner
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine, MarlinSettings, Steps
from tests.support.data import ROOT

FOLDER = ROOT.parent / "firmware" / "marlin"
CARTESIAN = MarlinSettings((200, 200, 12, 120), (1000, 1000, 200, 5000), 1250, 1250, 1250, None, (8, 8, 0.4, 1.5))
DELTA = MarlinSettings((300, 300, 300, 120), (3000, 3000, 3000, 5000), 1250, 1250, 1250, None, (8, 8, 8, 1.5))
KINDS = {
    "jd-6": replace(CARTESIAN, junction_deviation_mm=0.013, slowdown=False),
    "jd-1": replace(CARTESIAN, junction_deviation_mm=0.013, slowdown=False, minimum_steps_per_segment=1),
    "cj-6": replace(CARTESIAN, slowdown=False),
    "cj-1": replace(CARTESIAN, slowdown=False, minimum_steps_per_segment=1),
    "jd-6-slowdown": replace(CARTESIAN, junction_deviation_mm=0.013),
    "cj-6-slowdown": CARTESIAN,
    "delta-6": DELTA,
    "delta-1": replace(DELTA, minimum_steps_per_segment=1),
}
# arcs are read as chords within 5 µm, where Marlin cuts the circle itself; segments of one step depend on how
# floats are rounded
EXPECTED = {"arcs": 0.03, "tiny": 0.015}
TOTALS = FOLDER / "totals.csv"
pytestmark = pytest.mark.skipif(not TOTALS.exists(), reason="needs the data from outside")


def machine_of(kind: str) -> Machine:
    if kind.startswith("delta"):
        return replace(load_machine("kossel"), steps=Steps(80.0, extruder_steps_per_mm=93.0))
    machine = load_machine("prusa-mk3s")
    return replace(machine, steps=Steps((80.0, 80.0, 400.0), extruder_steps_per_mm=93.0))


def planned(kind: str, program: str) -> MarlinPlan:
    text = b"G28\n" + (FOLDER / "programs" / f"{program}.gcode").read_bytes()
    read = read_program(text, flavor="marlin", homed_mm=(0.0, 0.0, 0.0))
    return MarlinPlanner(machine_of(kind), KINDS[kind]).plan(read)


def totals() -> list[tuple[str, str, float]]:
    if not TOTALS.exists():
        return []
    rows = csv.DictReader(TOTALS.read_text().splitlines())
    return [(r["kind"], r["program"], float(r["duration_s"])) for r in rows if r["kind"] in KINDS]


@pytest.mark.parametrize(("kind", "program", "seconds"), totals(), ids=lambda x: str(x))
def test_every_program_takes_as_long_as_in_the_real_planner(kind: str, program: str, seconds: float) -> None:
    assert planned(kind, program).end_t == pytest.approx(seconds, rel=EXPECTED.get(program, 0.01))


def test_lines_that_set_limits_hold_from_there_on() -> None:
    """60 mm at 150 mm/s and 1000 mm/s², then at 500: each ramps for v/a, a rest apart."""
    machine, settings = machine_of("jd-6"), KINDS["jd-6"]
    planner = MarlinPlanner(machine, settings)
    parts = [b"G28\nG1 X60 F9000\nM400\n", b"M204 T500\nG1 X0 F9000\n"]
    whole = planner.plan(read_program(b"".join(parts), flavor="marlin", homed_mm=(0.0, 0.0, 0.0)))
    assert whole.duration == pytest.approx([60 / 150 + 150 / 1000, 60 / 150 + 150 / 500], rel=0.01)


def test_what_is_shorter_than_six_steps_is_joined_to_the_next_move() -> None:
    text = b"G28\nG1 X30 F6000\nG1 X30.05\nG1 X60\n"
    plan = MarlinPlanner(machine_of("jd-6"), KINDS["jd-6"]).plan(
        read_program(text, flavor="marlin", homed_mm=(0.0, 0.0, 0.0))
    )
    assert len(plan.blocks.order) == 2 and plan.duration[1] == 0.0
    assert plan.blocks.end[-1, 0] == 60 * 80
