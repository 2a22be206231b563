"""Excerpts: they hold what the whole recording holds there, and are used only where a discrepancy stands out."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ffcomp.diagnosis.observations import (
    EXCERPT_S,
)
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.measurement.recording import Recording
from models.file import load_machine

RATE_HZ, SECONDS = 1591.5, 4.0
FRICTION, DRIFT = "effects.coulomb_friction.force_n", "effects.sensor_clock_drift.relative_drift"


@cache
def problem() -> PrinterProblem:
    """Two motions, one of them twice, with noise and no signal: only lengths and commands matter."""
    return noisy({"a-1": (9.0, "Axyz"), "a-2": (9.0, "Axyz"), "b-1": (17.0, "Axyz")}, {})


def noisy(runs: dict[str, tuple[float, str]], said: dict[str, str]) -> PrinterProblem:
    """A printer that makes circles of these frequencies, rad/s, and feels noise along these axes."""
    machine, rng = load_machine("mp-delta-pro"), np.random.default_rng(4)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    fade = np.clip(np.minimum(t, t[-1] - t) / 0.3, 0, 1)[:, None]
    recordings = []
    for name, (f, axes) in runs.items():
        nozzle = [10.0, -5.0, 30.0] + fade * np.column_stack([np.sin(f * t), np.cos(2 * f * t), np.sin(3 * f * t) / 2])
        felt = {f"acc_{axis}": rng.standard_normal(len(t)) for axis in axes}
        gaps = np.zeros(len(t), dtype=bool)
        q = machine.kinematics.inverse(nozzle)
        recordings.append(Recording(f"{name}.csv", t, q, "carriage", felt, {}, gaps, said))
    return PrinterProblem(machine, recordings, ("coulomb_friction",))


@pytest.mark.parametrize(("values", "tolerance"), [({}, 5e-3), ({FRICTION: 2.0}, 0.02), ({DRIFT: 3e-4}, 5e-3)])
def test_an_excerpt_is_simulated_as_the_whole_is(values: dict[str, float], tolerance: float) -> None:
    whole, part = problem(), problem().excerpt()
    assert part is not None
    for long, short, rows in zip(whole.simulate(values), part.simulate(values), part.parts, strict=True):
        there = long[rows.first : rows.last]
        assert len(short) == rows.last - rows.first == pytest.approx(EXCERPT_S * RATE_HZ, rel=0.02)
        np.testing.assert_allclose(short, there, atol=tolerance * np.abs(there).max())
