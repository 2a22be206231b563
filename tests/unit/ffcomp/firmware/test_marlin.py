"""Marlin's plan, block by block, against what the real Marlin 2.1.2 makes of sixteen programs."""

from __future__ import annotations

import csv
import gzip
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ffcomp.firmware.marlin import PART_S, Marlin
from ffcomp.firmware.marlin_queue import Blocks, phases_of
from ffcomp.firmware.program import known_to_the_firmware, read_as_planned
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Program, limits_in_effect
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine, MarlinSettings, Steps
from tests.support.data import ROOT

FOLDER = ROOT.parent / "firmware" / "marlin"
TOTALS = FOLDER / "totals.csv"
CARTESIAN = MarlinSettings((200, 200, 12, 120), (1000, 1000, 200, 5000), 1250, 1250, 1250, None, (8, 8, 0.4, 1.5))
DELTA = MarlinSettings((300, 300, 300, 120), (3000, 3000, 3000, 5000), 1250, 1250, 1250, None, (8, 8, 8, 1.5))
BUILDS = {"jd": replace(CARTESIAN, junction_deviation_mm=0.013), "cj": CARTESIAN, "delta": DELTA}
KINDS = {
    f"{name}-{steps}{'-slowdown' * slow}": replace(build, minimum_steps_per_segment=steps, slowdown=slow)
    for name, build in BUILDS.items()
    for steps in (6, 1)
    for slow in (False, True)
}
SHIFTED = {True: 0.03, False: 0.07}  # of the blocks of deltas and arcs: a step beyond a half by a last digit, or not
START = (0.0, 0.0, 0.0)
needs_data = pytest.mark.skipif(not TOTALS.exists(), reason=f"needs the real planner's blocks, {FOLDER}")


def machine_of(kind: str) -> Machine:
    delta = kind.startswith("delta")
    steps = Steps(80.0 if delta else (80.0, 80.0, 400.0), extruder_steps_per_mm=93.0)
    return replace(load_machine("kossel" if delta else "prusa-mk3s"), marlin=KINDS[kind], steps=steps)


def read(text: bytes, machine: Machine) -> Program:
    return read_program(text, flavor="marlin", start=START, **known_to_the_firmware(machine))


@cache
def program_of(kind: str, name: str) -> Program:
    return read((FOLDER / "programs" / f"{name}.gcode").read_bytes(), machine_of(kind))


def test_a_delta_that_creeps_is_read_in_parts_of_little_motion_for_marlin_alone() -> None:
    """At 1 mm/s a line of text is 9,000 pieces: a megabyte would be hundreds of millions, planned at once."""
    machine = load_machine("mp-delta-pro")
    text = b"G28\nG1 X0 Y0 Z1 F6000\n" + b"G1 X45 F60\nG1 X0\n" * 20
    parts = list(read_as_planned([text], "creeps", machine, "marlin"))
    assert max(len(part.moves) for part in parts) <= PART_S * 200 < sum(len(part.moves) for part in parts) / 5
    assert b"".join(line for part in parts for line in part.lines) == text
    assert len(list(read_as_planned([text], "creeps", machine, "klipper"))) == 1


def plan_of(program: Program, machine: Machine) -> Trajectory:
    stop, wait = stops_and_waits(program)
    return Marlin().planner(program, machine)(program.moves, stop_before=stop, wait_before=wait)


def blocks_of(program: Program, machine: Machine) -> Blocks:
    stop, wait = stops_and_waits(program)
    return Marlin().planner(program, machine).blocks(program.moves, stop | (wait > 0.0))[0]


def real_blocks(kind: str, name: str) -> list[dict[str, str]]:
    text = gzip.decompress((FOLDER / kind / f"{name}.csv.gz").read_bytes()).decode()
    return list(csv.DictReader(text.splitlines()))


def totals() -> list[tuple[str, str, float]]:
    if not TOTALS.exists():
        return []
    rows = csv.DictReader(TOTALS.read_text().splitlines())
    return [(row["kind"], row["program"], float(row["duration_s"])) for row in rows]


@needs_data
@pytest.mark.parametrize(("kind", "name", "seconds"), totals(), ids=lambda x: str(x))
def test_every_program_takes_as_long_as_in_the_real_planner(kind: str, name: str, seconds: float) -> None:
    assert plan_of(program_of(kind, name), machine_of(kind)).end_t == pytest.approx(seconds, rel=0.01)


@needs_data
@pytest.mark.parametrize(
    ("kind", "name"),
    [row[:2] for row in totals() if (FOLDER / row[0] / f"{row[1]}.csv.gz").exists()],
    ids=lambda x: str(x),
)
def test_every_block_begins_cruises_and_ends_as_fast_as_in_the_real_planner(kind: str, name: str) -> None:
    rows = [row for row in real_blocks(kind, name) if row["block"] != "-1"]
    blocks = blocks_of(program_of(kind, name), machine_of(kind))
    assert len(blocks) == len(rows)
    mm_per_event = blocks.length / blocks.events
    for column, mine in (("nominal", blocks.nominal), ("entry", blocks.entry), ("exit", blocks.exit)):
        theirs = np.array([float(row[column]) for row in rows])
        off = np.abs(mine * mm_per_event / theirs - 1.0) > 0.02
        if column == "nominal" or not (kind.startswith("delta") or name in ("arcs", "dwell")):
            assert not off.any(), f"{column} of blocks {np.flatnonzero(off)}"
        else:
            assert off.sum() <= max(
                SHIFTED[kind.startswith("delta") and name != "arcs"] * len(rows), 1
            )  # of dwell: G92 X is planned as a stop


@needs_data
def test_trapezoids_have_the_real_planners_events() -> None:
    kind, name = "cj-6", "circle-1mm"
    rows = real_blocks(kind, name)
    blocks = blocks_of(program_of(kind, name), machine_of(kind))
    assert blocks.accelerate.tolist() == [float(row["accelerate_until"]) for row in rows]
    assert blocks.decelerate.tolist() == [float(row["decelerate_after"]) for row in rows]
    assert phases_of(blocks).duration == pytest.approx([float(row["duration"]) for row in rows], abs=2e-9)


def test_lines_that_set_limits_hold_from_there_on() -> None:
    """60 mm at 150 mm/s and 1000 mm/s², then at 500: each ramps for v/a, a rest apart."""
    machine = machine_of("jd-6")
    plan = plan_of(read(b"G1 X60 F9000\nM400\nM204 T500\nG1 X0 F9000\n", machine), machine)
    assert plan.duration == pytest.approx([60 / 150 + 150 / 1000, 60 / 150 + 150 / 500], rel=0.01)


@pytest.mark.parametrize(
    "line", ["M201X1000Y1000", "N5 M201 X1000 Y1000", "(c) M201 X1000 Y1000", "m201 y1000 x 1000", "M0201 X1000Y1000 ;"]
)
def test_limits_hold_in_every_spelling(line: str) -> None:
    """60 mm at 150 mm/s: planned, read and put back with the limits of the last line."""
    machine = machine_of("jd-6")
    program = read(f"M201 X200 Y200\n{line}\nG1 X60 F9000\n".encode(), machine)
    assert plan_of(program, machine).duration == pytest.approx([60 / 150 + 150 / 1000], rel=0.01)
    assert program.moves.acceleration.tolist() == [1000.0]
    assert limits_in_effect(program, {})["M201"].words == {"X": 1000.0, "Y": 1000.0}


def test_what_is_shorter_than_six_steps_is_joined_to_the_next_move() -> None:
    machine = machine_of("jd-6")
    program = read(b"G1 X30 F6000\nG1 X30.05\nG1 X60\n", machine)
    blocks, plan = blocks_of(program, machine), plan_of(program, machine)
    assert len(blocks) == 2 and blocks.end[-1, 0] == 60 * 80
    assert plan.duration.sum() == pytest.approx(phases_of(blocks).duration.sum(), rel=1e-9)
    assert plan.position([plan.end_t])[0, 0] == pytest.approx(60.0, abs=1e-6)


@pytest.mark.parametrize("kind", ["jd-6", "cj-1", "delta-6"])
def test_a_plan_keeps_to_the_path_at_every_moment(kind: str) -> None:
    """Moves follow each other without a gap, each from its start to its end, whatever blocks they are in."""
    machine = machine_of(kind)
    text = b"G1 X20 Y0 F6000\nG1 X20.04 Y.03\nG3 X0 Y20 I-20 J0 E1.03 F4800\nG1 E-1\nG1 X-5 Y3 E.4\n"
    program = read(text, machine)
    plan = plan_of(program, machine)
    before_end = plan.start_t + plan.duration - 1e-9
    assert plan.position(before_end)[:, :3] == pytest.approx(program.moves.end[:, :3], abs=1e-4)
    assert plan.start_t[1:] == pytest.approx((plan.start_t + plan.duration)[:-1], abs=1e-12)


def test_an_arc_is_cut_on_its_circle_where_marlins_chords_meet() -> None:
    machine = machine_of("jd-6")
    program = read(b"G1 X20 Y0 F6000\nG3 X0 Y20 I-20 J0 F4800\n", machine)
    assert np.hypot(*program.moves.end[1:, :2].T) == pytest.approx(20.0, abs=1e-6)
    assert len(blocks_of(program, machine)) == 1 + 32  # chords of 1 mm at most


@pytest.mark.parametrize(("version", "newer"), [((), False), ((2, 1, 2, 5), False), ((2, 1, 3), True), ((2, 2), True)])
def test_a_later_version_with_another_classic_jerk_is_named(version: tuple[int, ...], newer: bool) -> None:
    machine = replace(machine_of("cj-6"), firmware_version=version)
    assert ("another classic jerk" in Marlin().assumed(machine)) == newer
    of_deviation = replace(CARTESIAN, stated=(*MarlinSettings.__dataclass_fields__,))
    assert Marlin().assumed(replace(machine, marlin=of_deviation)) == ""
