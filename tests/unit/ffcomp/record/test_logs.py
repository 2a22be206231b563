"""Logs of motion and sensors: the command is in them, and the clock is exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.measurement.printer_logs import read_motion_log
from ffcomp.record.join import join_captures, load_recordings
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Plan, save_plan
from ffcomp.shapers.apply import shape
from ffcomp.shapers.pulses import SHAPERS, Shaper
from models.file import load_machine
from models.machine import Machine
from models.printer.printer import simulate_printer
from tests.support.motion_logs import accelerometer, trapq, write_log

BEGIN_S = 40.0  # print time of the first move


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
    overflows: Sequence[int] = (),
) -> Path:
    """What the logger says of the first experiment."""
    motion = plan.experiments[0].motion
    t = np.arange(-1.2, motion.duration_s + 0.8, 1 / 3200)
    commanded = shape(motion.nozzle, t, *shapers)
    carriages = machine.kinematics.inverse(commanded)
    felt = simulate_printer(machine, carriages, 1 / 3200).nozzle_acceleration
    noisy = felt + np.array([0.0, 0.0, 9.80665]) + np.random.default_rng(1).normal(0.0, 0.1, felt.shape)
    messages = [*trapq(motion.trajectory, BEGIN_S), *accelerometer("adxl345", BEGIN_S + t, noisy, overflows)]
    write_log(path, messages)
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


def test_a_shaper_that_was_on_and_lost_samples_are_refused(plan: Plan, machine: Machine, tmp_path: Path) -> None:
    both = (SHAPERS["mzv"](45.0, 0.1),) * 2
    found = join_captures([log_of(tmp_path / "shaped.json.gz", plan, machine, both)], plan, machine)
    assert not found.joined and "The firmware's input shaper was on" in found.refused[0].why
    found = join_captures(
        [log_of(tmp_path / "lost.json.gz", plan, machine, overflows=[0] * 10 + [2] * 90)], plan, machine
    )
    assert not found.joined and "The chip lost samples" in found.refused[0].why


def test_a_log_that_was_cut_off_is_read_as_far_as_it_goes(logged: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.json.gz"
    cut.write_bytes(logged.read_bytes()[:-400])
    assert read_motion_log(cut).nozzle.begin_s[0] == BEGIN_S


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
