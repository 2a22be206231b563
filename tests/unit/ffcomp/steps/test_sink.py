"""The archive: its keys, what reads back, and that nothing is left of a failure."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from ffcomp.errors import LimitsError
from ffcomp.firmware.program import plan_program
from ffcomp.planner.trajectory import Trajectory
from ffcomp.steps import compress, sink
from ffcomp.steps.archive import StepsError, read_steps
from ffcomp.steps.crossings import Knots
from ffcomp.steps.sink import Board, MotorTotal, StepSink
from gcode.reader import read_program
from models.errors import UnreachableError
from models.file import load_machine
from tests.support.knots import trajectory_knots

MACHINE = load_machine("mp-delta-pro")
BOARD = Board(extruder_steps_per_mm=415.0)
GCODE = (
    b"G1 X30 Y12 E2 F9000\nG1 X28 Y30 E3\nG1 E1 F2400\nG1 X-20 Y-20 Z10.3 F12000\nG4 P100\nG1 E3\nG1 X0 Y0 E5 F9000\n"
)
EVENTS = [(0.0, b"M106 S255\n"), (0.3, b"; caf\xe9\r\n"), (0.3, b""), (2.5, b"M117 a much longer line than those")]


def planned() -> Trajectory:
    return plan_program(read_program(GCODE, start=(0.0, 0.0, 10.0), flavor="klipper"), MACHINE).trajectory


def written(path: Path, error_s: float | None = None, at_once: int = 10_000) -> dict[str, MotorTotal]:
    with closing(StepSink(MACHINE, BOARD, path, error_s)) as out:
        for t, line in EVENTS:
            out.event(t, line)
        for knots in trajectory_knots(planned(), 0.1):
            for first in range(0, len(knots.places) - 1, at_once):
                begin_t = knots.start_t + knots.spacing_s * first
                out.knots(Knots(begin_t, knots.spacing_s, knots.places[first : first + at_once + 1]))
        return out.finish()


def test_what_was_written_is_the_plan(tmp_path: Path) -> None:
    """At every step the plan is half-way between the two microsteps; the filament too."""
    written(tmp_path / "steps")
    plan, motors = planned(), read_steps(tmp_path / "steps")
    assert list(motors) == ["a", "b", "c", "e"]
    for k, motor in enumerate(motors.values()):
        place = plan.position(motor.time_s - 0.1)
        height = MACHINE.kinematics.inverse(place[:, :3])[:, k] if k < 3 else place[:, 3]
        border = (motor.level_mm[1:] + motor.level_mm[:-1]) / 2
        assert len(border) > 900
        assert np.abs(height - border).max() < 1e-4
    assert abs(motors["e"].level_mm[-1] - 5.0) <= 0.5 / 415.0


def test_rows_are_the_same_steps_within_the_error(tmp_path: Path) -> None:
    exact, rows = written(tmp_path / "exact"), written(tmp_path / "rows", 12.5e-6)
    before, after = read_steps(tmp_path / "exact"), read_steps(tmp_path / "rows")
    for motor, one in before.items():
        np.testing.assert_array_equal(after[motor].direction, one.direction)
        assert np.abs(after[motor].time_s - one.time_s).max() <= 12.5e-6 + 1e-12
        assert exact[motor].steps == rows[motor].steps == len(one.time_s)
        assert exact[motor].rows == 0 and 0 < rows[motor].rows * 8 < len(one.time_s)


@pytest.mark.parametrize("error_s", [None, 12.5e-6])
def test_how_the_path_is_cut_changes_no_byte(
    error_s: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path / "whole", error_s)
    monkeypatch.setattr(sink, "BLOCK_PIECES", 150)
    monkeypatch.setattr(compress, "BATCH_STEPS", 100)
    written(tmp_path / "cut", error_s, at_once=400)
    assert (tmp_path / "whole").read_bytes() == (tmp_path / "cut").read_bytes()


def knots(*vertices: tuple[float, float, float], begin_s: float = 0.1, spacing_s: float = 0.5) -> Knots:
    return Knots(begin_s, spacing_s, np.column_stack([np.array(vertices), np.zeros(len(vertices))]).astype(np.float64))


def write_all(target: Path, parts: Iterable[Knots]) -> None:
    with closing(StepSink(MACHINE, BOARD, target)) as out:
        for each in parts:
            out.knots(each)
        out.finish()


WRONG = {
    "the path jumps from X = 1.0000": (
        StepsError,
        [knots((0, 0, 5), (1, 0, 5)), knots((1, 0.1, 5), (2, 0, 5), begin_s=0.7)],
    ),
    r"t = 0.5000000 s, before 0.6": (
        StepsError,
        [knots((0, 0, 5), (1, 0, 5)), knots((1, 0, 5), (2, 0, 5), begin_s=0.5)],
    ),
    r"t = -0.0080000 s, before 0.0": (StepsError, [knots((0, 0, 5), (1, 0, 5), begin_s=-0.008)]),
    "farther from a tower than the length of its arm": (UnreachableError, [knots((0, 0, 5), (300, 300, 5))]),
    "Motor a needs more than 500000 steps": (LimitsError, [knots((0, 0, 5), (0, 0, 105), spacing_s=0.01)]),
}


@pytest.mark.parametrize("sentence", WRONG)
def test_what_motors_cannot_do_is_said_and_leaves_nothing(sentence: str, tmp_path: Path) -> None:
    error, parts = WRONG[sentence]
    target = tmp_path / "steps"
    target.write_bytes(b"old")
    with pytest.raises(error, match=sentence):
        write_all(target, parts)
    assert target.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["steps"]


def test_a_little_too_fast_is_put_off_and_reported(tmp_path: Path) -> None:
    """Three microsteps at twice the pace that a board can follow: the third is as late as two half pulses."""
    pace = BOARD.pulse_spacing_s
    with closing(StepSink(MACHINE, BOARD, tmp_path / "steps")) as out:
        out.knots(knots((0, 0, 5.0), (0, 0, 5.0 + 3 / MACHINE.steps.steps_per_mm), spacing_s=1.5 * pace))
        total = out.finish()["a"]
    assert total.steps == 3
    assert total.latest_s == pytest.approx(2 * 0.5 * pace, abs=2e-7)
    assert np.diff(read_steps(tmp_path / "steps")["a"].time_s).min() == pytest.approx(pace)
