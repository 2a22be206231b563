"""A command that was corrupted is never written: the sliced lines go out instead, and a warning says so first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.compensation import solve
from ffcomp.compensation.job import Job
from ffcomp.compensation.result import Result
from ffcomp.errors import LimitsError
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.time_scaling import PlannedSection
from gcode.embedded import original
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Machine
from tests.support.compensated import plainly
from validation.invariants import violations

FIRST = b"G1 X120 Y100 E1 F3000\nG1 X120 Y120 E1\n"
SECOND = b"G1 X100 Y120 E1\nM106 S100\nG1 X100 Y100 E1\n"
OFFSET = (10.0, 5.0)
DATA = b"G28\nG90\nM83\nG1 X100 Y100 Z5 F6000\n" + FIRST + b"G4 P100\n" + SECOND + b"G1 E-1 F1800\n" + FIRST


def zigzags(vertices: FloatArray) -> None:
    vertices[30:40:2, 1] += 0.9


def leaves(vertices: FloatArray) -> None:
    vertices[:, 1] += 0.7 * np.sin(np.linspace(0.0, np.pi, len(vertices)))


def begins_beside(vertices: FloatArray) -> None:
    vertices[0, 0] += 0.02


def ends_beside(vertices: FloatArray) -> None:
    vertices[-3:, 0] += [0.01, 0.02, 0.03]


def jerks(vertices: FloatArray) -> None:
    vertices[50, 0] += 0.4


def is_no_number(vertices: FloatArray) -> None:
    vertices[10] = np.nan


CORRUPTIONS = [zigzags, leaves, begins_beside, ends_beside, jerks, is_no_number]


def corrupted(patch: pytest.MonkeyPatch, corrupt: Callable[[FloatArray], None]) -> None:
    """Let the solver return a wrong command for the section whose first move has no feed of its own."""
    solved = solve.solve_feasible

    def wrong(model: InverseModel, request: PlannedSection) -> SolvedSection:
        right = solved(model, request)
        if request.program.lines[request.program.moves.line[request.section.first]] not in SECOND:
            return right
        vertices = right.solution.vertices.copy()
        corrupt(vertices)
        return replace(right, solution=replace(right.solution, vertices=vertices))

    patch.setattr(solve, "solve_feasible", wrong)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("voron-300")


@pytest.fixture(scope="module")
def whole(machine: Machine) -> tuple[bytes, Result]:
    lines = Job(DATA, "print.gcode", machine, plainly(flavor="klipper", offset_mm=OFFSET, predict=False)).lines()
    return b"".join(lines), lines.value


@pytest.mark.parametrize("corrupt", CORRUPTIONS)
def test_what_fails_its_check_goes_out_as_it_was_sliced(
    machine: Machine,
    corrupt: Callable[[FloatArray], None],
    whole: tuple[bytes, Result],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    right, plain = whole
    assert SECOND not in right and not plain.statistics.unsafe
    corrupted(monkeypatch, corrupt)
    options = plainly(flavor="klipper", offset_mm=OFFSET, predict=corrupt is zigzags)
    stream = Job(DATA, "print.gcode", machine, options).lines()
    out = b"".join(stream)
    assert b"\nG1 X110 Y125 E1 ; ffcomp\n" in out and b"\nG1 X110 Y105 E1 ; ffcomp\n" in out
    assert original(out) == DATA
    assert violations(DATA, out, machine, OFFSET, flavor="klipper") == []
    (unsafe,) = stream.value.statistics.unsafe
    assert (unsafe.first_line, unsafe.last_line) == (8, 10)
    first = stream.value.warnings[0]
    assert first.startswith("One motion goes out as sliced, without compensation (lines 8 to 10)")
    assert unsafe.why in first
    shares = stream.value.statistics.shares
    assert shares.compensated.path_mm == pytest.approx(80.0)
    assert shares.path < plain.statistics.shares.path
    begin, end = right.index(b";section line=5 "), right.index(b"G4 P100")
    assert right[begin:end] in out, "what comes before is compensated as it was"
    errors = {name: track.contour_rms_um for name, track in stream.value.predicted.items()}
    assert not errors or errors["compensated"] < errors["uncompensated"]


def test_marlin_takes_up_the_filament_where_the_sliced_lines_left_it(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = load_machine("ender-3")
    data = DATA.replace(b"M83\n", b"M83\nM221 S90\n")
    corrupted(monkeypatch, zigzags)
    stream = Job(data, "print.gcode", machine, plainly(flavor="marlin", predict=False)).lines()
    out = b"".join(stream)
    assert len(stream.value.statistics.unsafe) == 1 and SECOND in out and original(out) == data
    assert violations(data, out, machine, flavor="marlin") == []


def test_steps_follow_the_plan_where_a_command_fails_its_check(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = Job(DATA, "print.gcode", machine, plainly(kind="host", flavor="klipper", predict=False))
    before = job.write_steps(tmp_path / "right.ffm").statistics
    corrupted(monkeypatch, zigzags)
    after = job.write_steps(tmp_path / "print.ffm").statistics
    assert len(after.unsafe) == 1 and after.print_time_s == pytest.approx(before.print_time_s, abs=0.02)


def test_a_motion_that_is_cut_is_refused(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part of it is written already, or is another process's."""
    monkeypatch.setattr("ffcomp.compensation.chunks.LONGEST_S", 8.0)
    turns = np.arange(700) / 9.0
    circle = np.stack([150.0 + 20.0 * np.cos(turns), 150.0 + 20.0 * np.sin(turns)], axis=1).tolist()
    begin = DATA + b"G4 P100\n" + SECOND.partition(b"M106")[0]
    data = begin + b"".join(b"G1 X%.3f Y%.3f E.1\n" % (x, y) for x, y in circle)
    corrupted(monkeypatch, lambda vertices: zigzags(vertices[len(vertices) // 4 :]))
    with pytest.raises(LimitsError, match="failed its check: it leaves its path"):
        b"".join(Job(data, "print.gcode", machine, plainly(flavor="klipper", predict=False)).lines())
