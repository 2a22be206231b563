"""Pitches that the data show, whatever they are: an axis' file states no full steps."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.diagnosis.axis_problem import AxisProblem
from ffcomp.diagnosis.pitches import likely_pitches
from ffcomp.identification.axis_shots import shots_of
from tests.unit.ffcomp.diagnosis.test_axis_problem import DRIVE, runs_of


@pytest.mark.parametrize("pitch", [0.8, 1.7])
def test_the_pitch_of_a_hidden_ripple_is_the_best_one(pitch: float) -> None:
    runs = runs_of(DRIVE, 5, cogging={"amplitude_mm": 0.004, "pitch_mm": pitch, "phase_deg": 50.0})
    travel = float(np.ptp(runs[0].drive))
    found = likely_pitches(DRIVE, shots_of(DRIVE, runs), (2.0, 60.0), 3)
    assert abs(1 / found[0] - 1 / pitch) < 0.3 / travel  # of the turns that fit into the travel, a part of one


def test_without_a_motion_there_is_no_pitch() -> None:
    runs = [
        type(run)(run.source, run.time_s, 0 * run.drive, False, run.acceleration, {}, {}) for run in runs_of(DRIVE, 5)
    ]
    assert likely_pitches(DRIVE, shots_of(DRIVE, runs), (2.0, 60.0), 3) == []


def test_a_ripple_is_looked_for_at_the_pitches_of_the_data() -> None:
    runs = runs_of(DRIVE, 5, cogging={"amplitude_mm": 0.004, "pitch_mm": 1.7, "phase_deg": 50.0})
    problem = AxisProblem(DRIVE, runs, ("cogging",))
    (cogging,) = problem.candidates
    pitch = next(n for n in cogging.shapes if n.name.endswith("pitch_mm"))
    assert abs(1 / pitch.start - 1 / 1.7) < 0.3 / float(np.ptp(runs[0].drive))
    assert {point[pitch.name] for point in cogging.grid} >= {pitch.start}
