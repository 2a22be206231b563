"""Excerpts: they hold what the whole recording holds there, and are used only where a discrepancy stands out."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ffcomp.diagnose.diagnosis import noise_floor
from ffcomp.diagnose.estimation import EstimationProblem, estimation_problem, excerpt_of
from ffcomp.diagnose.excerpts import EXCERPT_S
from ffcomp.diagnose.noise import whitener
from ffcomp.diagnose.observe import quick_length
from ffcomp.diagnose.printer_problem import PrinterProblem
from ffcomp.measurement.recording import Recording
from models.file import load_machine

RATE_HZ, SECONDS = 1591.5, 4.0
FRICTION, DRIFT = "effects.coulomb_friction.force_n", "effects.sensor_clock_drift.relative_drift"


@cache
def problem() -> PrinterProblem:
    """Two motions, one of them twice, with noise and no signal: only lengths and commands matter."""
    machine, rng = load_machine("mp-delta-pro"), np.random.default_rng(4)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    fade = np.clip(np.minimum(t, t[-1] - t) / 0.3, 0, 1)[:, None]
    recordings = []
    for name, f in (("a-1", 9.0), ("a-2", 9.0), ("b-1", 17.0)):
        nozzle = [10.0, -5.0, 30.0] + fade * np.column_stack([np.sin(f * t), np.cos(2 * f * t), np.sin(3 * f * t) / 2])
        felt = {f"acc_{axis}": rng.standard_normal(len(t)) for axis in "Axyz"}
        gaps = np.zeros(len(t), dtype=bool)
        q = machine.kinematics.inverse(nozzle)
        recordings.append(Recording(f"{name}.csv", t, q, "carriage", felt, {}, gaps, {}))
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


def test_excerpts_are_of_both_halves_and_alike_for_repeats() -> None:
    part = problem().excerpt()
    assert part is not None
    first, repeat, other = part.parts
    middle = len(problem().observations[0].measured) / 2
    assert first == repeat
    assert (first.first + first.last) / 2 < middle < (other.first + other.last) / 2
    np.testing.assert_array_equal(
        part.observations[1].measured, problem().observations[1].measured[first.first : first.last]
    )


def test_only_a_discrepancy_that_stands_out_is_searched_in_an_excerpt() -> None:
    estimation = whitened(problem())
    part = excerpt_of(estimation, 100.0)
    assert part is not None
    assert part.share == pytest.approx(EXCERPT_S / SECONDS, rel=0.05)
    assert len(part.measured) == part.share * len(estimation.measured)
    assert excerpt_of(estimation, 1.5 * estimation.tolerance) is None
    assert excerpt_of(part, 100.0) is None  # what is short already is not cut again


def test_lengths_are_transformed_quickly() -> None:
    assert [quick_length(n) for n in (1, 9601, 7798, 1920, 1910)] == [1, 9600, 7776, 1920, 1904]
    assert all(len(o.measured) == quick_length(len(o.measured)) for o in problem().observations)


def test_one_array_for_two_repeats_is_whitened_as_two_are(monkeypatch: pytest.MonkeyPatch) -> None:
    estimation, transformed = whitened(problem()), []
    rfft = np.fft.rfft
    monkeypatch.setattr(np.fft, "rfft", lambda many: transformed.append(len(many)) or rfft(many))
    a, again, b = problem().simulate({})
    assert a is again
    once = estimation.whiten([a, a, b])
    assert sum(transformed) == 2
    np.testing.assert_array_equal(once, estimation.whiten([a, a.copy(), b]))
    assert sum(transformed) == 5
