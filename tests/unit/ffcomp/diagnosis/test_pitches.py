"""Pitches that the data show, whatever they are: an axis' file states no full steps."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.diagnosis.axis_problem import likely_pitches, pitches_of_force
from ffcomp.diagnosis.problems import check_repeats
from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_shots import shots_of
from ffcomp.measurement.axis_run import AxisRun
from models.kinds import machine_of_axis
from models.vibration.driven_axis import DrivenAxis
from tests.unit.ffcomp.diagnosis.test_axis_problem import DRIVE, runs_of


@pytest.mark.parametrize("pitch", [0.8, 1.7])
def test_the_pitch_of_a_hidden_ripple_is_the_best_one(pitch: float) -> None:
    runs = runs_of(DRIVE, 5, cogging={"amplitude_mm": 0.004, "pitch_mm": pitch, "phase_deg": 50.0})
    travel = float(np.ptp(runs[0].drive))
    found = likely_pitches(DRIVE, shots_of(DRIVE, runs), (2.0, 60.0), 3)
    assert abs(1 / found[0] - 1 / pitch) < 0.3 / travel  # of the turns that fit into the travel, a part of one


def test_a_force_and_a_speed_show_no_pitch_without_a_place() -> None:
    t = np.arange(800) / 400.0
    run = AxisRun("a.csv", t, np.sin(20 * t), "force", {}, {}, other={"vel_q": np.cos(20 * t)})
    free = machine_of_axis("stage", DrivenAxis("force", 1.0, 0.0, 2.0))
    assert likely_pitches(free, shots_of(free, [run]), (2.0, 60.0), 3) == []
    with pytest.raises(MeasurementError, match="an encoder's position shows it too"):
        check_repeats([run])


def test_lines_of_cogging_are_seen_in_the_force_of_what_turns() -> None:
    """Three lines a turn, of a rotor that is turned slowly by a known torque; without them no pitch is told."""
    motor = machine_of_axis("motor", DrivenAxis("current", 0.004, 0.0, 0.01, unit="rad"))
    t = np.arange(4000) / 400.0
    q, v, a = 0.5 * t + 0.05 * np.sin(3 * t), 0.5 + 0.15 * np.cos(3 * t), -0.45 * np.sin(3 * t)
    plain = 0.004 * a + 0.01 * v + 1e-3 * np.random.default_rng(3).normal(size=len(t))
    lines = sum(s * np.sin(n * q) + c * np.cos(n * q) for n, s, c in ((7, 0.8, 0.0), (28, 0.0, 0.5), (12, 0.3, 0.2)))
    told = []
    for force in (plain, plain + lines):
        run = AxisRun("a.csv", t, force, "current", {}, {"pos_q": 1e3 * q})
        told.append([round(2e3 * np.pi / x) for x in pitches_of_force(motor, shots_of(motor, [run]), 6)])
    assert told[0] == [] and sorted(told[1]) == [7, 12, 28]
