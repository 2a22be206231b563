"""A real print as the experiment: the print stays what it is, and the plan holds the motion of its sections."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.errors import NothingToDo
from ffcomp.planner.program import firmware_plan
from ffcomp.record.gcode_writer import DEFAULT_CHIPS, Firmware
from ffcomp.record.join import join_captures
from ffcomp.record.plan import Plan, load_plan, save_plan
from ffcomp.record.planning import plan_print, print_lines
from gcode.program import Program
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine
from tests.support.recordings import write_captures

EXAMPLE = Path(__file__).parents[4] / "docs" / "examples" / "print.gcode"


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("mp-delta-pro")


@pytest.fixture(scope="module")
def planned(machine: Machine) -> tuple[Plan, Program]:
    return plan_print(EXAMPLE, machine, "klipper")


def text_of(planned: tuple[Plan, Program]) -> list[bytes]:
    return list(print_lines(*planned, Firmware("klipper", DEFAULT_CHIPS["klipper"])))


def test_the_print_stays_what_it_is(planned: tuple[Plan, Program]) -> None:
    ours = (b"; ", b";\n", b"SET_INPUT_SHAPER", b"M400\n", b"G4 P", b"ACCELEROMETER_MEASURE", b"FFCOMP_RESTORE")
    lines, original = text_of(planned), EXAMPLE.read_bytes().splitlines(keepends=True)
    kept = iter(lines)
    assert all(any(line == other for other in kept) for line in original)  # in order
    added = len(lines) - len(original)
    starts = sum(line.startswith(b"ACCELEROMETER_MEASURE") for line in lines)
    assert starts == 2 * len(planned[0].experiments) > 0
    assert added < sum(line.startswith(ours) for line in lines) + 1


def test_the_plan_is_the_printed_motion(planned: tuple[Plan, Program], machine: Machine) -> None:
    """Read back, each section between two toggles takes its time, and goes where the plan says."""
    lines = [
        line for line in text_of(planned) if not line.startswith(b"ACCELEROMETER_MEASURE")
    ]  # unknown to our reader
    program = read_program(b"".join(lines), "recorded.gcode")
    whole = firmware_plan(program, machine)
    for each in planned[0].experiments:
        n = len(each.motion.speed)
        first = next(
            k for k in range(len(program.moves)) if np.array_equal(program.moves.end[k : k + n], each.motion.ends_mm)
        )
        t = np.linspace(0.0, each.duration_s, 400)
        np.testing.assert_allclose(
            whole.position(whole.start_t[first] + t)[:, :3], each.motion.nozzle(t), atol=1e-6, err_msg=each.name
        )


def test_captures_of_a_print_are_joined(planned: tuple[Plan, Program], machine: Machine, tmp_path: Path) -> None:
    save_plan(planned[0], tmp_path / "p.json")
    again = load_plan(tmp_path / "p.json")
    assert again.print_file == "print.gcode" and again.repeats == 1
    captures = write_captures(tmp_path / "p.json", machine, tmp_path)
    found = join_captures(captures, again, machine)
    assert len(found.joined) == len(captures) and not found.refused


def test_a_print_without_motion_says_so(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "empty.gcode"
    path.write_text("G28\nG90\nG1 X0 Y0 Z5 F3000\nG1 X5\n", encoding="utf-8")
    with pytest.raises(NothingToDo, match=r"has no motion of 1\.5 to 15 s without a stop"):
        plan_print(path, machine, "klipper")
