"""Logs of motion and sensors: the command is in them, the shaper included, and the clock is exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ffcomp.measurement.printer_logs import read_motion_log
from ffcomp.record.executions import differences
from ffcomp.record.join import join_captures, load_recordings
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Plan, save_plan
from ffcomp.shapers.pulses import Shaper
from ffcomp.shapers.smooth import SHAPERS
from models.file import load_machine
from models.machine import Machine
from models.printer.printer import simulate_printer
from tests.support.motion_logs import accelerometer, stepq, trapq, write_log
from tests.support.recordings import shaped

BEGIN_S = 40.0  # print time of the first move
SETTINGS = {
    "stepper_a": {"rotation_distance": 40.0, "microsteps": 16, "full_steps_per_rotation": 200, "gear_ratio": []},
}


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("kossel")


@pytest.fixture(scope="module")
def plan(machine: Machine) -> Plan:
    made = make_plan(machine, Request(seconds=2.0, repeats=1, places_mm=[(0.0, 0.0)]))
    return replace(made, experiments=tuple(each for each in made.experiments if each.kind == "zigzag"))


@pytest.fixture(scope="module")
def logged(plan: Plan, machine: Machine, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return log_of(tmp_path_factory.mktemp("log") / "mylog.json.gz", plan, machine)


def log_of(
    path: Path,
    plan: Plan,
    machine: Machine,
    shapers: Sequence[Shaper | None] = (None, None),
    settings: dict[str, Any] = SETTINGS,
    overflows: Sequence[int] = (),
    height_off_mm: float = -3.0,
) -> Path:
    """What the logger says of the first experiment; the firmware counts carriages from another height than we do."""
    motion = plan.experiments[0].motion
    t = np.arange(-1.2, motion.duration_s + 0.8, 1 / 3200)
    commanded = shaped(motion.nozzle, t, shapers)
    carriages = machine.kinematics.inverse(commanded)
    felt = simulate_printer(machine, carriages, 1 / 3200).nozzle_acceleration
    noisy = felt + np.array([0.0, 0.0, 9.80665]) + np.random.default_rng(1).normal(0.0, 0.1, felt.shape)
    messages = [*trapq(motion.trajectory, BEGIN_S), *accelerometer("adxl345", BEGIN_S + t, noisy, overflows)]
    for i, name in enumerate(("stepper_a", "stepper_b", "stepper_c")):
        heights = CubicSpline(BEGIN_S + t, carriages[:, i] + height_off_mm)
        step_mm = 1.0 / float(machine.steps.per_motor[i])
        messages += stepq(name, heights, step_mm, BEGIN_S - 1.0, BEGIN_S + motion.duration_s + 0.7)
    write_log(path, messages, {"configfile": {"settings": settings}})
    return path


def test_a_log_is_joined_exactly(plan: Plan, machine: Machine, logged: Path) -> None:
    index = logged.with_name("mylog.index.gz")
    found = join_captures([logged, index], plan, machine)
    (joined,) = found.joined
    assert not found.refused and found.remarks == ()
    assert joined.clock.offset_s == pytest.approx(-1.0, abs=5e-4) and joined.clock.ratio == 1.0
    assert joined.recording.comments["delay_sd_s"] == "5e-05"
    t = joined.begin_s + joined.recording.time_s
    np.testing.assert_allclose(joined.recording.command, plan.experiments[0].motion.nozzle(t), atol=1e-9)


def test_a_shaper_that_was_on_is_in_the_command(plan: Plan, machine: Machine, tmp_path: Path) -> None:
    both = (SHAPERS["mzv"](45.0, 0.1),) * 2
    path = log_of(tmp_path / "mylog.json.gz", plan, machine, both)
    found = join_captures([path], plan, machine)
    (joined,) = found.joined
    assert "the input shaper was on. What the motors did is taken for the command" in found.remarks[0]
    t = joined.begin_s + joined.recording.time_s
    truth = shaped(plan.experiments[0].motion.nozzle, t, both)
    np.testing.assert_allclose(joined.recording.command, truth, atol=0.02)  # a step is 0.0125 mm
    assert np.abs(truth - plan.experiments[0].motion.nozzle(t)).max() > 0.05
    assert joined.clock.correlation > 0.99


def test_a_configuration_that_contradicts_the_file_and_lost_samples_are_said(
    plan: Plan, machine: Machine, tmp_path: Path
) -> None:
    other = {**SETTINGS["stepper_a"], "rotation_distance": 32.0, "arm_length": 300.0}
    counted = [0] * 10 + [2] * 90
    path = log_of(tmp_path / "mylog.json.gz", plan, machine, settings={"stepper_a": other}, overflows=counted)
    found = join_captures([path], plan, machine)
    assert not found.joined and "The chip lost samples" in found.refused[0].why
    said = " ".join(differences(read_motion_log(path), machine))
    assert "stepper_a: the configuration has 100 steps/mm, and the machine file 80" in said
    assert "stepper_a: the arm is 300 mm in the configuration" in said


def test_a_log_that_was_cut_off_is_read_as_far_as_it_goes(
    plan: Plan, machine: Machine, logged: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.json.gz"
    cut.write_bytes(logged.read_bytes()[:-400])
    assert read_motion_log(cut).nozzle.begin_s[0] == BEGIN_S
    found = join_captures([cut], plan, machine)
    assert "there is no index next to the log" in " ".join(found.remarks)


def test_another_motion_is_refused_and_diagnose_takes_logs(
    plan: Plan, machine: Machine, logged: Path, tmp_path: Path
) -> None:
    other = make_plan(machine, Request(seconds=2.0, repeats=1, seed=9, places_mm=[(0.0, 0.0)]))
    assert (
        "None of the plan's experiments is in its commanded motion"
        in join_captures([logged], other, machine).refused[0].why
    )
    save_plan(plan, tmp_path / "moves.json")
    (recording,) = load_recordings([logged], machine, tmp_path / "moves.json")
    assert recording.command_space == "nozzle"
