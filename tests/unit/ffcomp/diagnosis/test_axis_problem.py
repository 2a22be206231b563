"""The diagnosis of one axis: shots, windows and band from the data, and effects that are named."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.axis_problem import AxisProblem
from ffcomp.diagnosis.diagnosis import Outcome, diagnose
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_shots import shots_of
from ffcomp.measurement.axis_run import AxisRun, read_axis_run
from models.effects.catalogue import with_effects
from models.kinds import driven_axis, machine_of_axis
from models.machine import Machine
from models.printer.one_axis import simulate_axis
from models.vibration.driven_axis import DrivenAxis

RATE = 500.0
STAGE = machine_of_axis("stage", DrivenAxis("force", 20.0, 0.0, 60.0), uncertainty={"default": 0.02})
DRIVE = machine_of_axis("drive", DrivenAxis("position", 2.0, 2e4, 30.0), uncertainty={"default": 0.02})


def runs_of(machine: Machine, seed: int, **effects: Any) -> list[AxisRun]:
    """Two repeats of one motion with noise; of a free axis the position, of a driven one the acceleration."""
    rng = np.random.default_rng(seed)
    t = np.arange(3000) / RATE
    shape = rng.normal(size=40)
    wave = np.interp(t, np.linspace(0, t[-1], 40), shape * np.r_[0, np.ones(38), 0])
    given = 30.0 * wave if driven_axis(machine).by_force else 4.0 * np.convolve(wave, np.hanning(41) / 20, "same")
    motion = simulate_axis(with_effects(machine, effects), given, 1 / RATE)
    found = []
    for k in (1, 2):
        if driven_axis(machine).by_force:
            position = {"pos_q": motion.position_mm + 1e-4 * rng.normal(size=len(t))}
            found.append(AxisRun(f"a-{k}.csv", t, given, "force", {}, position))
        else:
            noise = 0.03 * rng.normal(size=len(t))
            felt = {"acc_q": motion.acceleration + noise}
            found.append(AxisRun(f"a-{k}.csv", t, given, "position", felt, {}))
    return found


LAWS = ("coulomb_friction", "stribeck_friction", "bristle_friction")


@pytest.mark.parametrize(
    ("law", "hidden"),
    [
        ("coulomb_friction", {"force_n": 8.0}),
        ("stribeck_friction", {"force_n": 6.0, "extra_force_n": 5.0, "velocity_mm_per_s": 8.0}),
        ("bristle_friction", {"force_n": 8.0, "presliding_mm": 0.3}),
    ],
)
def test_laws_of_one_cause_are_told_apart_or_told_together(law: str, hidden: dict[str, float]) -> None:
    """The confidence is that of dry friction, however near another law of it comes; a near one is told."""
    answer = found(STAGE, *LAWS, "guide_damping", **{law: hidden})
    assert answer.named is not None and answer.named.names == (law,)
    size = answer.final.values[f"effects.{law}.force_n"]
    assert size == pytest.approx(hidden["force_n"], rel=0.03 if law == "coulomb_friction" else 0.2)
    said = DiagnosisResult(search=answer)
    assert said.found[0].confidence > 0.99
    assert {h.names[0] for h in answer.competing} <= {each.name for each in said.confounded_with}


def found(machine: Machine, *names: str, **effects: Any) -> Outcome:
    return diagnose(
        AxisProblem(machine, runs_of(machine, 3, **effects), names or ("coulomb_friction", "belt_hardening"))
    )


def test_an_arm_that_stands_up_is_simulated_in_shots_whatever_its_file_says_of_gravity() -> None:
    """In one piece it would fall over: the true file would have a larger gap than one without gravity."""
    arm = machine_of_axis("arm", DrivenAxis("force", 0.2, 0.0, 0.05, unit="rad"))
    heavy = with_effects(arm, {"pendulum_gravity": {"force_n": 3.3, "angle_deg": 0.0}})
    t = np.arange(2000) / RATE
    angle = np.pi + 0.3 * np.sin(2 * np.pi * 0.7 * t)
    speed, change = np.gradient(angle, 1 / RATE), -((2 * np.pi * 0.7) ** 2) * (angle - np.pi)
    torque = 0.2 * change + 0.05 * speed + 3.3 * np.sin(angle)
    place = {"pos_q": 1e3 * angle + 0.01 * np.random.default_rng(5).normal(size=len(t))}
    run = AxisRun("a.csv", t, torque, "force", {}, place)
    both = [shots_of(machine, [run])[0] for machine in (arm, heavy)]
    assert both[0].length == both[1].length > 0
    errors = [
        one.without_beginnings({"pos_q": one.simulate(m).position_mm - place["pos_q"]})["pos_q"]
        for one, m in zip(both, (arm, heavy), strict=True)
    ]
    assert np.sqrt(np.mean(errors[1] ** 2)) < 0.05 * np.sqrt(np.mean(errors[0] ** 2))


def test_of_two_sensors_the_one_that_lags_is_found_with_its_time() -> None:
    """One sensor alone would lag as its drive does, so that it is not looked for there."""
    lag = {"sensor_lag": {"time_constant_s": [0.0, 0.0, 2e-3], "damping_ratio": 0.7}}
    late = with_effects(DRIVE, lag)
    rng, both = np.random.default_rng(5), []
    for run in runs_of(DRIVE, 3):
        sensed = shots_of(late, [replace(run, position={"pos_q": run.drive})])[0].simulate(late).sensed(late)
        place = {"pos_q": sensed["pos_q"] + 1e-3 * rng.normal(size=len(run.time_s))}
        felt = {"acc_q": sensed["acc_q"] + 0.03 * rng.normal(size=len(run.time_s))}
        both.append(replace(run, acceleration=felt, position=place))
    names = ("command_delay", "guide_damping", "sensor_lag")
    told = diagnose(AxisProblem(DRIVE, both, names))
    assert told.named is not None and told.named.names == ("sensor_lag",)
    stated = DiagnosisResult(search=told).parameters("sensor_lag")["time_constant_s"]
    assert stated.value == pytest.approx([0.0, 0.0, 2e-3], abs=1e-4) and stated.high[1] == 0.0
    alone = AxisProblem(DRIVE, runs_of(DRIVE, 3), names)
    assert {c.name for c in alone.candidates} == {"guide_damping", "command_delay"}


@pytest.mark.parametrize(
    ("header", "sentence"),
    [
        ("t_s,pos_q_mm", "needs what drove it"),
        ("t_s,force_n,cmd_q_mm", "one of them"),
        ("t_s,force_n", "No sensor column"),
        ("t_s,force_n,pos_x_mm", "No sensor column .*'pos_x_mm' is not known; did you mean 'pos_q_mm'"),
        ("time,force_n,pos_q_mm", "Column t_s"),
    ],
)
def test_headers_of_runs(header: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    width = header.count(",") + 1
    path.write_text(header + "\n" + "\n".join(",".join(["0.1"] * width) for _ in range(3)))
    with pytest.raises(MeasurementError, match=sentence):
        read_axis_run(path)


def test_a_run_of_what_turns_is_read_compressed_and_says_what_it_leaves_out(tmp_path: Path) -> None:
    t = np.arange(200) / 200
    columns = [np.sin(t), np.cos(t), 1 + t, np.degrees(1.0) * t, 0.1 * t, 7 + t, 0.5 * t, np.ones(200)]
    table = np.column_stack([t, *columns])
    header = "t_s,current_a,torque_n_m,pos_q_rad,pos_motor_deg,vel_q_rad_per_s,supply_v,extra_torque_n_m,temperature_c"
    with gzip.open(tmp_path / "a-2.csv.gz", "wt") as file:
        np.savetxt(file, table, delimiter=",", header=header, comments="")
    read = read_axis_run(tmp_path / "a-2.csv.gz", "current")
    assert (read.command_space, read.by_force, read.repeat_of) == ("current", True, "a")
    np.testing.assert_allclose(read.drive, np.sin(t))
    np.testing.assert_allclose(read.signals["pos_q"], 1e3 * (1 + t))
    np.testing.assert_allclose(read.signals["pos_motor"], 1e3 * t, atol=1e-9)
    np.testing.assert_allclose(read.signals["vel_q"], 1e2 * t)
    assert read.supply_v is not None and read.extra is not None and read.supply_v[-1] == pytest.approx(7 + t[-1])
    assert ["torque_n_m" in read.remarks[0], "temperature_c" in read.remarks[1], len(read.remarks)] == [True, True, 2]
    with pytest.raises(MeasurementError, match="one of them"):
        read_axis_run(tmp_path / "a-2.csv.gz")


def test_a_run_is_read_and_must_fit_the_file(tmp_path: Path) -> None:
    run = runs_of(STAGE, 1)[0]
    path = tmp_path / "run-1.csv"
    table = np.column_stack([run.time_s, run.drive, run.position["pos_q"]])
    np.savetxt(path, table, delimiter=",", header="t_s,force_n,pos_q_mm", comments="")
    read = read_axis_run(path)
    assert read.repeat_of == "run" and read.sample_rate_hz == pytest.approx(RATE)
    np.testing.assert_allclose(read.position["pos_q"], run.position["pos_q"])
    with pytest.raises(MeasurementError, match=r"axis\.input of drive is 'position'"):
        AxisProblem(DRIVE, [read])
