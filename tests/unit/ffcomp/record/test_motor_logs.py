"""Logs of one motor with an encoder: they are found by their steps, and become runs with that motor's place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.measurement.recording import read_recording
from ffcomp.record.join import join_captures, load_recordings
from ffcomp.record.moves import Request, make_plan
from ffcomp.record.plan import Plan, save_plan
from ffcomp.record.result import recording_lines
from ffcomp.shapers.smooth import SHAPERS
from models.arrays import FloatArray
from models.file import load_machine
from models.machine import Machine
from models.printer.printer import simulate_printer
from tests.support.recordings import shaped

HEADER = "Sample,Timestamp,Raw Encoder Reading,Measured Motor Steps,Target Motor Steps"
RATE_HZ = 1000.0
RATIO = 1.0 + 5e-5  # of the board's clock


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("kossel")


@pytest.fixture(scope="module")
def plan(machine: Machine) -> Plan:
    made = make_plan(machine, Request(seconds=2.0, repeats=2, places_mm=[(20.0, 10.0)]))
    return replace(made, experiments=tuple(each for each in made.experiments if each.kind == "zigzag"))


@pytest.fixture(scope="module")
def played(plan: Plan, machine: Machine) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The plan's motion by a printer with friction: times, the carriages' command and place."""
    rubbing = replace(machine, effects={"coulomb_friction": {"force_n": 3.0}})
    t = np.arange(-0.6, plan.experiments[0].duration_s + 0.5, 1 / 3200)
    command = machine.kinematics.inverse(plan.experiments[0].motion.nozzle(t))
    return t, command, simulate_printer(rubbing, command, 1 / 3200).carriage_mm


def log(
    path: Path,
    played: tuple[FloatArray, FloatArray, FloatArray],
    motor: int = 0,
    steps_per_mm: float = -80.0,
    begin_s: float = -0.3,
    end_s: float = 60.0,
    tail: str = "",
) -> Path:
    """What the board writes of one motor that counts from anywhere."""
    t, command, place = played
    at = np.arange(max(begin_s, t[0]), min(end_s, t[-1]), 1 / RATE_HZ)
    target, measured = (steps_per_mm * np.interp(at, t, heights[:, motor]) + 12345.0 for heights in (command, place))
    stamps = 1e3 * (at - at[0]) / RATIO + 7.0
    rows = [
        f"{k},{ms:.2f},{int(16 * m)},{m:.2f},{x:.2f}"
        for k, (ms, m, x) in enumerate(zip(stamps, measured, target, strict=True))
    ]
    path.write_text("\n".join([HEADER, *rows]) + "\n" + tail, encoding="utf-8")
    return path


@pytest.mark.parametrize(("motor", "steps_per_mm"), [(0, -80.0), (2, 5.0)])  # microsteps, and full ones
def test_a_log_becomes_a_run_of_its_motor(
    plan: Plan,
    machine: Machine,
    played: tuple[FloatArray, FloatArray, FloatArray],
    tmp_path: Path,
    motor: int,
    steps_per_mm: float,
) -> None:
    found = join_captures([log(tmp_path / "50_2026.csv", played, motor, steps_per_mm)], plan, machine)
    assert not found.refused
    (joined,) = found.joined
    signal = f"pos_{'ABC'[motor]}"
    assert joined.name == f"{plan.experiments[0].name}-{'ABC'[motor]}-1"
    assert joined.clock.offset_s == pytest.approx(-0.3, abs=1e-4)
    assert joined.clock.ratio == pytest.approx(RATIO, abs=5e-5)
    tau = joined.begin_s + joined.recording.time_s
    t, command, place = played
    truth = np.interp(tau, t, place[:, motor])
    np.testing.assert_allclose(joined.recording.position[signal], truth, atol=0.02)
    assert np.abs(truth - np.interp(tau, t, command[:, motor])).max() > 0.03  # the friction is seen
    assert any("blind to arms, effector and frame" in each for each in found.notes(plan, machine))


def test_a_log_that_begins_with_the_motion_has_a_gap_before_it_and_a_second_one_is_the_repeat(
    plan: Plan, machine: Machine, played: tuple[FloatArray, FloatArray, FloatArray], tmp_path: Path
) -> None:
    paths = [log(tmp_path / f"{k}.csv", played, begin_s=0.01) for k in (1, 2, 3)]
    found = join_captures(paths, plan, machine)
    assert [each.repeat for each in found.joined] == [1, 2]
    assert "There are 2 logs of motor A" in found.refused[0].why
    recording = found.joined[0].recording
    before = found.joined[0].begin_s + recording.time_s < 0.009
    assert np.isnan(recording.position["pos_A"][before]).all() and recording.gaps[before].all()
    written = tmp_path / f"{found.joined[0].name}.csv"
    written.write_bytes(b"".join(recording_lines(recording)))
    read = read_recording(written)
    assert list(read.position) == ["pos_A"] and not read.acceleration and read.repeat_of.endswith("-A")
    save_plan(plan, tmp_path / "moves.json")
    assert len(load_recordings([paths[0]], machine, tmp_path / "moves.json")) == 1


def test_what_is_no_execution_of_the_plan_is_refused_with_what_was_found(
    plan: Plan, machine: Machine, played: tuple[FloatArray, FloatArray, FloatArray], tmp_path: Path
) -> None:
    def why(path: Path, made: Plan = plan, told: Machine = machine) -> str:
        found = join_captures([path], made, told)
        assert not found.joined and found.refused[0].file == str(path)
        return found.refused[0].why

    good = log(tmp_path / "good.csv", played)
    assert "but with 100 steps/mm" in why(log(tmp_path / "size.csv", played, steps_per_mm=100.0))
    assert "it was cut off" in why(log(tmp_path / "short.csv", played, end_s=plan.experiments[0].duration_s - 0.1))
    assert "None of the plan's motions" in why(
        good, make_plan(machine, Request(seconds=2.0, seed=9, places_mm=[(-50.0, 0.0)]))
    )
    silent = replace(machine, steps=replace(machine.steps, stated=()))
    assert "Write steps_per_mm" in why(good, told=silent)
    assert "'Buffer overflowed'" in why(log(tmp_path / "lost.csv", played, tail="Buffer overflowed\n"))
    t, _, place = played
    nozzle = shaped(plan.experiments[0].motion.nozzle, t, (SHAPERS["mzv"](100.0, 0.1),) * 2)
    smooth = (t, machine.kinematics.inverse(nozzle), place)
    assert "the input shaper was on" in why(log(tmp_path / "shaped.csv", smooth))
