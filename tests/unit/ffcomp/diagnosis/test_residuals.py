"""Runs of another author's printer against our simulation: nothing but the noise where nothing is hidden."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.cli.app import app
from ffcomp.diagnosis.axis_problem import AxisProblem
from ffcomp.diagnosis.noise import noise_floor, whitener
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.where import ResidualCurve, residual_curves
from ffcomp.measurement.axis_run import AxisRun
from ffcomp.measurement.recording import Recording
from models.arrays import FloatArray
from models.file import load_machine
from models.kinds import machine_of_axis
from models.vibration.driven_axis import DrivenAxis
from tests.support.cli import CliRunner
from tests.support.data import DATA, needed

RUNS = DATA / "runs"


def gap_of(case: str, *, machine: Path | None = None) -> Any:
    folder = needed(RUNS / case)
    files = [str(path) for path in sorted((folder / "runs").glob("*.csv"))]
    answer = CliRunner().invoke(app, ["gap", *files, "-m", str(machine or folder / "machine.toml"), "--json"])
    assert answer.exit_code == 0, answer.output
    return json.loads(answer.stdout)


def test_nothing_hidden_leaves_nothing_but_the_noise() -> None:
    found = gap_of("nothing-hidden")
    assert found["schema"] == "ffcomp-gap/1" and found["noise_from_repeats"]
    assert found["nrms"] == pytest.approx(found["noise_nrms"], rel=0.02)
    for size in (*found["where"]["signals"].values(), *found["where"]["runs"].values()):
        assert size["nrms"] < 1.1 * size["noise_nrms"]


def test_a_hidden_effect_is_a_gap_and_adding_it_closes_it(tmp_path: Path) -> None:
    case = "coulomb-friction"
    found = gap_of(case)
    assert found["nrms"] > 20 * found["noise_nrms"]
    assert sum(share for _, _, share in found["where"]["frequency_hz"]) == pytest.approx(1.0)
    truth = (RUNS / case / "truth.toml").read_text(encoding="utf-8")
    better = tmp_path / "better.toml"
    effect = truth[truth.index("[effects.") :]
    better.write_text((RUNS / case / "machine.toml").read_text(encoding="utf-8") + "\n" + effect, encoding="utf-8")
    closed = gap_of(case, machine=better)
    assert closed["nrms"] < 1.2 * closed["noise_nrms"]


def made_recordings(noise: float, count: int, rng: np.random.Generator) -> list[Recording]:
    """Repeats of one motion on the library's printer, by the plant itself, with white noise."""
    machine = load_machine("mp-delta-pro")
    t = np.arange(0, 1.5, 1 / 1600)
    rest = np.array([[330.0, 330.0, 330.0]])
    moved = 0.3 * np.sin(2 * np.pi * 37 * t)[:, None] * np.array([1.0, -0.4, 0.2]) * np.minimum(1, t / 0.2)[:, None]
    blank = {f"acc_{a}": np.zeros(len(t)) for a in "ABCxyz"}
    first = Recording("x-1.csv", t, rest + moved, "carriage", blank, {}, {})
    true = PrinterProblem(machine, [first], ()).simulate({})[0]
    return [
        Recording(f"x-{i}.csv", t, rest + moved, "carriage", dict(zip(blank, (true + n).T, strict=True)), {}, {})
        for i, n in enumerate(noise * rng.standard_normal((count, *true.shape)), 1)
    ]


def test_whitened_noise_has_variance_one() -> None:
    recordings = made_recordings(0.2, 6, np.random.default_rng(0))
    plant = PrinterProblem(load_machine("mp-delta-pro"), recordings, ())
    simulated = plant.simulate({})
    floor = noise_floor(plant)
    assert floor.from_repeats
    white = whitener(plant.observations, floor)
    errors = white([r.measured - y for r, y in zip(plant.observations, simulated, strict=True)])
    assert np.var(errors) == pytest.approx(1.0, abs=0.03)
    density = floor.density["acc_A"]
    assert np.median(density) == pytest.approx(0.2**2 / 800, rel=0.06)  # white noise: variance over the Nyquist band


# ---- residual curves ----


RATE, MASS, DAMPING, NOISE = 500.0, 2.0, 8.0, 0.02
STAGE = DrivenAxis("force", MASS, 0.0, DAMPING)
Law = Callable[[FloatArray, FloatArray], FloatArray]  # position mm, speed m/s -> N


def slow_drag(_: FloatArray, v: FloatArray) -> FloatArray:
    """Holds back only near 20 mm/s: no friction law of the catalogue."""
    return np.asarray(1.5 * np.tanh(v / 0.002) * np.exp(-((np.abs(v) / 0.02) ** 4)))


def problem(law: Law, axis: DrivenAxis = STAGE, seed: int = 1) -> AxisProblem:
    """Three motions whose drive's force holds what the machine file lacks."""
    rng, t, runs = np.random.default_rng(seed), np.arange(4000) / RATE, []
    for k in range(3):
        f, phase = rng.uniform(0.3, 1.6, 4), rng.uniform(0, 6.28, 4)
        waves = [(0.012 / each, 2 * np.pi * each, p) for each, p in zip(f, phase, strict=True)]
        q = sum(a * np.sin(w * t + p) for a, w, p in waves)
        v = sum(a * w * np.cos(w * t + p) for a, w, p in waves)
        acceleration = sum(-a * w**2 * np.sin(w * t + p) for a, w, p in waves)
        force = MASS * acceleration + DAMPING * v + law(1e3 * q, v) + NOISE * rng.normal(size=len(t))
        place = 1e3 * q + 1e-4 * rng.normal(size=len(t))
        runs.append(AxisRun(f"run{'abc'[k]}.csv", t, force, "force", {}, {"pos_q": place}))
    return AxisProblem(
        machine_of_axis("stage", axis, uncertainty={"default": 0.05}), runs, ("pendulum_gravity", "ground_spring")
    )


def inside(curve: ResidualCurve, law: FloatArray) -> float:
    """Share of bins whose 90 % band holds a law's value."""
    return float(np.mean(np.abs(np.array(curve.residual) - law) <= np.array(curve.half_width)))


def test_a_law_of_speed_shows_its_shape_and_its_regime() -> None:
    curve = residual_curves(problem(slow_drag), {})[0]
    assert (curve.signal, curve.against, curve.unit, curve.against_unit) == ("force", "speed", "N", "mm/s")
    speed = np.array(curve.at)
    assert inside(curve, slow_drag(speed, 1e-3 * speed)) > 0.7
    assert curve.share > 0.6 and curve.sentence.startswith("residual force against speed: ")
    assert replace(curve, share=0.05).sentence.startswith("residual force depends little on speed: 5.0 % of its power")
    assert curve.regime.startswith("most of it below ") and curve.regime.endswith(" mm/s")
    assert 15.0 < float(curve.regime.split()[-2]) < 35.0


def test_the_band_covers_a_law_as_often_as_it_says() -> None:
    """Over many recordings, at bins far from where the law is curved within a bin."""
    held = []
    for seed in range(12):
        (curve,) = [
            c for c in residual_curves(problem(lambda x, _: 0.02 * x, seed=seed), {}) if c.against == "position"
        ]
        held.append(inside(curve, 0.02 * np.array(curve.at)))
    assert 0.8 < np.mean(held) < 0.99
