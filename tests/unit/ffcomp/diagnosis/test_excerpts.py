"""Excerpts: they hold what the whole recording holds there, and are used only where a discrepancy stands out."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ffcomp.diagnosis.fidelity import excerpt_of, fit_in_excerpt, hypothesis_in_whole
from ffcomp.diagnosis.fit import EstimationProblem, Fit, estimation_problem
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.noise import noise_floor, whitener
from ffcomp.diagnosis.observations import (
    EXCERPT_MOTIONS,
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


def whitened(of: PrinterProblem) -> EstimationProblem:
    return estimation_problem(of, whitener(of.observations, noise_floor(of), of.band_hz))


@pytest.mark.parametrize(("values", "tolerance"), [({}, 5e-3), ({FRICTION: 2.0}, 0.02), ({DRIFT: 3e-4}, 5e-3)])
def test_an_excerpt_is_simulated_as_the_whole_is(values: dict[str, float], tolerance: float) -> None:
    whole, part = problem(), problem().excerpt()
    assert part is not None
    for long, short, rows in zip(whole.simulate(values), part.simulate(values), part.parts, strict=True):
        there = long[rows.first : rows.last]
        assert len(short) == rows.last - rows.first == pytest.approx(EXCERPT_S * RATE_HZ, rel=0.02)
        np.testing.assert_allclose(short, there, atol=tolerance * np.abs(there).max())


def test_delays_of_recordings_that_an_excerpt_leaves_out_come_back_as_nothing() -> None:
    part = excerpt_of(whitened(many_motions()), 100.0)
    assert part is not None
    names, left = [[n.name for n in p.parameters] for p in (many_motions(), part.problem)]
    assert set(left) < set(names) and len(names) - len(left) == MOTIONS_MADE - EXCERPT_MOTIONS
    assert [n for n in names if not n.startswith("recording.")] == [n for n in left if not n.startswith("recording.")]
    z = 0.1 * np.arange(len(names), dtype=np.float64)
    filed = Fit(tuple(many_motions().parameters), z, np.zeros(1), np.zeros((1, len(z))))
    shown = fit_in_excerpt(part, filed)
    assert shown.values == {name: filed.values[name] for name in left}
    assert shown.jacobian.shape == (len(part.measured), len(left))
    whole = hypothesis_in_whole(many_motions(), Hypothesis((), shown))
    assert [n.name for n in whole.fit.parameters] == names
    np.testing.assert_allclose(whole.fit.z, [x if name in left else 0.0 for name, x in zip(names, z, strict=True)])


MOTIONS_MADE = 8


@cache
def many_motions() -> PrinterProblem:
    """Eight motions at one place, each a recording whose clock may be off."""
    return noisy({f"m{n}": (5.0 + n, "x") for n in range(MOTIONS_MADE)}, {"delay_sd_s": "1e-4"})
