from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.identification.paper import RationalFit, fit_rational
from models.file import load_machine
from models.kinds import delta_vibration
from models.vibration.substructures import command_frf
from tests.support.identification import FREQUENCY_HZ, blank, measured

MACHINE = load_machine("mp-delta-pro")
CARRIAGE = delta_vibration(MACHINE).carriage
ALONE = blank(FREQUENCY_HZ, input="cmd_A", output="pos_A", setup="carriage")


def fit_without_noise() -> RationalFit:
    h = command_frf(CARRIAGE, ALONE.s)
    return fit_rational(replace(ALONE, value=h, variance=np.full(len(h), 1e-20)), 2, 4)


def test_coefficients_of_a_known_function_come_back_to_all_digits() -> None:
    fit = fit_without_noise()
    m, k = CARRIAGE.moving_mass_kg, CARRIAGE.belt_stiffness_n_per_m
    drive = CARRIAGE.drive
    assert drive is not None
    damping = (CARRIAGE.belt_damping_n_s_per_m + CARRIAGE.guide_damping_n_s_per_m) / m
    expected = np.polymul([1, drive.d2_per_s, drive.d0_per_s2], [1, damping, k / m])[::-1]
    np.testing.assert_allclose(fit.denominator, expected, rtol=1e-7)
    assert max(fit.zeros.real) == pytest.approx(drive.d0_per_s2 / -drive.d1_per_s, rel=1e-6)


@pytest.mark.slow
def test_uncertainties_are_those_of_sixty_noise_draws() -> None:
    fits = [fit_rational(measured(MACHINE, [ALONE], 40.0, seed)[0], 2, 4) for seed in range(60)]
    coefficients = np.array([fit.coefficients for fit in fits])
    stated = np.mean([np.sqrt(np.diag(fit.covariance)) for fit in fits], axis=0)
    np.testing.assert_allclose(np.std(coefficients, axis=0), stated, rtol=0.3)
    off = np.mean(coefficients, axis=0) - fit_without_noise().coefficients
    assert (np.abs(off) < 4 * stated / np.sqrt(60)).all()  # unbiased
