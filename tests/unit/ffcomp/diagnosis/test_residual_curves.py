"""What is not explained is drawn: a hidden law outside the catalogue shows its shape within the curve's band."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffcomp.diagnosis.axis_problem import AxisProblem
from ffcomp.diagnosis.residual_curves import ResidualCurve, residual_curves
from ffcomp.measurement.axis_run import AxisRun
from models.arrays import FloatArray
from models.kinds import machine_of_axis
from models.vibration.driven_axis import DrivenAxis

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
        runs.append(AxisRun(f"run{'abc'[k]}.csv", t, force, True, {}, {"pos_q": place}, {}))
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
