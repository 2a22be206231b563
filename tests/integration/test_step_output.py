"""A print as step timings: the steps are the command, line by line on its clock."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.compensation.job import Job
from ffcomp.compensation.result import Result
from ffcomp.steps.archive import read_steps
from ffcomp.steps.crossings import Knots
from ffcomp.steps.sink import BEFORE_S, Board
from gcode.reader import read_program
from models.machine import Machine
from tests.support.compensated import job
from tests.support.prints import squares
from tests.support.steps import read_events

BOARD = Board(extruder_steps_per_mm=400.0)


def steps_job(data: bytes, machine: Machine, error_s: float | None, **chosen: Any) -> Job:
    kind = "klipper-steps" if error_s else "steps"
    return job(data, machine, kind=kind, extruder_steps_per_mm=400.0, **chosen)


def written(machine: Machine, path: Path, error_s: float | None = None) -> Result:
    return steps_job(squares(1), machine, error_s).write_steps(path)


def level_at(steps: object, t: np.ndarray) -> np.ndarray:
    """Where a motor holds at times t, mm."""
    return steps.level_mm[np.searchsorted(steps.time_s, t, side="right")]  # type: ignore[attr-defined, no-any-return]


@pytest.mark.parametrize("error_s", [None, 12.5e-6])
def test_compensated_steps_are_the_command(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error_s: float | None
) -> None:
    seen = []
    from ffcomp.compensation import step_output as stepping

    def watched(start_t: float, spacing_s: float, places: np.ndarray) -> Knots:
        seen.append((start_t, spacing_s, places[:, :3], places[:, 3]))
        return Knots(start_t, spacing_s, places)

    monkeypatch.setattr(stepping, "Knots", watched)
    target = tmp_path / "steps.npz"
    result = written(machine, target, error_s=error_s)
    motors = read_steps(target)
    fastest, beyond = 300.0, []  # mm/s, of a carriage: what an error in time can make of one in place
    for start_t, spacing_s, vertices, filament in seen:
        t = start_t + spacing_s * np.arange(len(vertices))
        heights = machine.kinematics.inverse(vertices)
        for i, name in enumerate("abc"):
            allowed = 0.5001 / machine.steps.steps_per_mm + fastest * (error_s or 1e-7)
            error = np.abs(level_at(motors[name], t) - heights[:, i])
            # a step that turns back within 750 µs is left out, as Klipper does: then up to a step, at few knots
            assert error.max() < 1.01 / machine.steps.steps_per_mm
            beyond += (error > allowed).tolist()
        assert np.abs(level_at(motors["e"], t) - filament).max() < 1.01 / 400 + 60 * (error_s or 1e-7)
    assert np.mean(beyond) < 0.002
    ends = [start_t + spacing_s * (len(vertices) - 1) for start_t, spacing_s, vertices, _ in seen]
    assert ends[-1] - BEFORE_S == pytest.approx(result.statistics.print_time_s, abs=1e-9)
    assert result.predicted["compensated"].contour_rms_um > 0


def test_every_other_line_has_its_moment(machine: Machine, tmp_path: Path) -> None:
    target = tmp_path / "steps.npz"
    written(machine, target)
    program = read_program(squares(1))
    times, lines = read_events(target)
    assert lines == [program.lines[e.line].rstrip(b"\r\n") for e in program.events]
    assert (np.diff(times) >= 0).all() and times[0] == pytest.approx(BEFORE_S)


WAITING = b"""G28
G1 X0 Y0 Z10 F3000
G4 P5000
M117 a
G1 X20 Y0 F3000
G4 P4000
M117 b
G1 X0 Y0 E1 F1200
G4 P3000
M117 c
G4 S0.8
"""


@pytest.mark.parametrize("error_s", [12.5e-6, None])
def test_every_wait_is_in_the_steps(machine: Machine, tmp_path: Path, error_s: float | None) -> None:
    """Before the first motion, where a chunk is cut, and after the last motion."""
    target = tmp_path / "steps.npz"
    result = steps_job(WAITING, machine, error_s, flavor="marlin", predict=False).write_steps(target)
    times, lines = read_events(target)
    at = {line: t - BEFORE_S for line, t in zip(lines, times.tolist(), strict=True)}
    moves_s = result.statistics.print_time_s - 12.8
    assert 0.8 < moves_s < 1.6  # Marlin runs short pieces of slow lines on a delta faster than asked
    assert at[b"M117 a"] == pytest.approx(5.0, abs=1e-6)
    assert at[b"G4 P3000"] - at[b"M117 a"] == pytest.approx(4.0 + moves_s, abs=1e-6)
    assert at[b"M117 b"] - at[b"G4 P4000"] == pytest.approx(4.0, abs=1e-6)
    assert at[b"M117 c"] - at[b"G4 P3000"] == pytest.approx(3.0, abs=1e-6)
    first = float(read_steps(target)["a"].time_s[0]) - BEFORE_S
    assert 4.9 < first < 5.1
