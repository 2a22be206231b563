from __future__ import annotations

import numpy as np
import pytest

from ffcomp.errors import SolverError
from ffcomp.identification.rational import fit_rational, fit_values
from models.file import load_machine
from models.kinds import delta_vibration
from models.vibration.substructures import command_frf
from tests.support.identification import FREQUENCY_HZ, blank, measured

MACHINE = load_machine("mp-delta-pro")
CARRIAGE = delta_vibration(MACHINE).carriage
S = 2j * np.pi * FREQUENCY_HZ


def noisy_carriage(seed: int):  # type: ignore[no-untyped-def]
    return measured(MACHINE, [blank(FREQUENCY_HZ, input="cmd_A", output="pos_A", setup="carriage")], 40.0, seed)


def test_coefficients_of_a_known_function_come_back_to_all_digits() -> None:
    h = command_frf(CARRIAGE, S)
    fit = fit_values(S, h[None], np.full((1, len(h)), 1e-20), 2, 4)
    m, k = CARRIAGE.moving_mass_kg, CARRIAGE.belt_stiffness_n_per_m
    drive = CARRIAGE.drive
    assert drive is not None
    damping = (CARRIAGE.belt_damping_n_s_per_m + CARRIAGE.guide_damping_n_s_per_m) / m
    expected = np.polymul([1, drive.d2_per_s, drive.d0_per_s2], [1, damping, k / m])[::-1]
    np.testing.assert_allclose(fit.denominator, expected, rtol=1e-7)
    np.testing.assert_allclose(fit(S)[0], h, atol=1e-9)
    assert max(fit.zeros().real) == pytest.approx(drive.d0_per_s2 / -drive.d1_per_s, rel=1e-6)


@pytest.mark.slow
def test_uncertainties_are_those_of_a_hundred_noise_draws() -> None:
    found = []
    for seed in range(100):
        fit = fit_rational(noisy_carriage(seed), 2, 4)
        mode = fit.mode(fit.poles[-1])
        found.append((mode.frequency_rad_per_s, mode.damping_ratio, mode.frequency_sd, mode.damping_sd, fit.misfit))
    omega, zeta, omega_sd, zeta_sd, misfit = np.array(found).T
    assert np.std(omega) == pytest.approx(np.mean(omega_sd), rel=0.25)
    assert np.std(zeta) == pytest.approx(np.mean(zeta_sd), rel=0.25)
    truth = np.sqrt(CARRIAGE.belt_stiffness_n_per_m / CARRIAGE.moving_mass_kg)
    assert abs(np.mean(omega) - truth) < 4 * np.mean(omega_sd) / 10  # unbiased
    assert np.mean(misfit) == pytest.approx(1.0, abs=0.02)


def test_poles_are_those_of_an_independent_method() -> None:
    """Least-squares complex frequency (LSCF), as sdypy-EMA has it."""
    ema = pytest.importorskip("sdypy.EMA", reason="sdypy-EMA is not installed")
    f = np.arange(2.0, 400.1, 0.25)
    frequencies, damping = np.array([43.0, 86.0, 240.0]), np.array([0.02, 0.03, 0.015])
    s, omega = 2j * np.pi * f, 2 * np.pi * frequencies
    residues = np.array([[1.0, -0.5, 0.8], [0.7, 0.9, -0.4]])
    h = np.einsum("rm,mk->rk", residues, s**2 / (s**2 + 2 * (damping * omega)[:, None] * s + (omega**2)[:, None]))
    rng = np.random.default_rng(1)
    noise = 1e-3 * (rng.normal(size=h.shape) + 1j * rng.normal(size=h.shape))
    fit = fit_values(s, h + noise, np.full(h.shape, 2e-6), 6, 6)
    modes = [fit.mode(p) for p in fit.poles if p.imag > 0]
    model = ema.Model(h + noise, f, lower=2, upper=400, pol_order_high=30)
    model.get_poles(show_progress=False)
    model.select_closest_poles(list(frequencies))
    for mode, other_hz, other_damping in zip(modes, model.nat_freq, model.nat_xi, strict=True):
        assert mode.frequency_rad_per_s / 2 / np.pi == pytest.approx(other_hz, rel=2e-3)
        assert mode.damping_ratio == pytest.approx(other_damping, rel=0.05)
    assert [m.frequency_rad_per_s / 2 / np.pi for m in modes] == pytest.approx(frequencies, rel=1e-4)


def test_fewer_values_than_unknowns_are_refused() -> None:
    with pytest.raises(SolverError, match="3 measured values cannot determine a rational fit of 7"):
        fit_values(S[:3], np.ones((1, 3), complex), np.ones((1, 3)), 2, 4)
