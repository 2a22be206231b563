"""The paper's numbers and equations that do not hold, each worked out again. Its Table I is typed in here once.

Rods against shares of force, and the sign of Eq. 13 along a helix, are in test_receptance.py and test_delta.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.arrays import constant
from models.kinds import delta_vibration, with_parts
from models.machine import Machine

M_C, M_F, M_1, M_2 = 0.179, 0.032, 0.542, 0.109
C, B, K = 5.31, 13.4, 1.21e5
M = M_C + M_F / 2
PAPERS_PLACES = np.array([[0.0, 0.0], [-80.0, 0.0], [40.0, -69.0], [40.0, 69.0]])


# --- The drive


def test_the_drives_delay(as_printed: Machine) -> None:
    """−dφ/dω at zero: (d₂ − d₁)/d₀ by the drive, 1.5 ms of it |d₁|/d₀ by its zero; b/k more by the guide."""
    drive = delta_vibration(as_printed).carriage.drive
    assert drive is not None
    assert abs(drive.d1_per_s) / drive.d0_per_s2 == pytest.approx(1.5e-3, abs=2e-5)
    slow = np.array([0.01])
    g = np.diag(as_printed.vibration.frequency_response(np.zeros(2), slow)[0])
    delay = -np.angle(g) / (2 * np.pi * slow)
    np.testing.assert_allclose(delay, (drive.d2_per_s - drive.d1_per_s) / drive.d0_per_s2 + B / K, rtol=1e-4)


# --- Equations


def test_equation_13_has_the_wrong_sign(as_printed: Machine) -> None:
    """Its velocity term, worked out from s_i, ṡ_i, T as printed, is minus what finite differences find."""
    geometry = as_printed.kinematics
    x, v, step = np.array([35.0, -20.0, 40.0]), np.array([120.0, 70.0, -30.0]), 1e-3
    q = geometry.inverse(x + np.array([-step, 0.0, step])[:, None] * v)
    rate, curvature = (q[2] - q[0]) / (2 * step), (q[0] - 2 * q[1] + q[2]) / step**2
    j = geometry.jacobian(x[None])[0]
    left = -j @ curvature  # Ẍ − J q̈ of a straight line at constant speed
    s = np.column_stack([x[:2] - geometry.towers_mm, x[2] + geometry.effector_height_mm - q[1]])
    p = np.array([0.0, 0.0, -1.0])
    s_rate = v + rate[:, None] * p
    printed = np.linalg.solve(s, (s_rate @ j + np.diag(s_rate @ p)) @ rate)
    np.testing.assert_allclose(printed, -left, rtol=1e-4)
    np.testing.assert_allclose(geometry.compiled().rate_term(x[None], v[None])[0], left, rtol=1e-4)


def test_the_determinant_of_the_assembly_is_equation_68_three_times_over(rigid) -> None:
    """At the centre of a centred machine α is J's singular value squared: det Z is the product of three such D."""
    machine = rigid()
    effector = replace(
        delta_vibration(machine).effector,
        extruder_stiffness_n_per_m=constant([9e3] * 3),
        extruder_damping_n_s_per_m=constant([20.0] * 3),
    )
    carriage = replace(delta_vibration(machine).carriage, belt_damping_n_s_per_m=C, guide_damping_n_s_per_m=B)
    machine = with_parts(machine, carriage=carriage, effector=effector)
    alphas = np.linalg.svd(machine.kinematics.jacobian(np.zeros((1, 2)))[0], compute_uv=False) ** 2
    expected = np.concatenate([np.roots(_corrected(alpha, 20.0, 9e3)) for alpha in alphas])
    found = machine.vibration.poles(np.zeros((1, 2)))[0]
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected), rtol=1e-6)


def _corrected(alpha: float, b_j: float, k_j: float) -> list[float]:
    """Eq. 68 with its s² term put right, of a carriage of 0.195 kg."""
    total = M + alpha * (M_1 + M_2)
    return [
        (M + alpha * M_1) * M_2,
        total * b_j + M_2 * (C + B),
        total * k_j + M_2 * K + (C + B) * b_j,
        (C + B) * k_j + b_j * K,
        k_j * K,
    ]


# --- The force map


def test_eq_25_makes_the_rigid_modes_too_fast(rigid) -> None:
    """43.5, 43.5, 86 Hz by virtual work, 75, 75, 107 Hz by Eq. 25: by closed form and by eigenvalues of M⁻¹K."""
    offset, total = (10.21, -16.52, 19.31), M_1 + M_2
    for force_map, expected in (("virtual_work", [43.5, 43.5, 86.25]), ("paper", [75.0, 75.1, 107.1])):
        machine = rigid(force_map, offset)
        j = machine.kinematics.jacobian(np.zeros((1, 2)))
        mass = M * np.eye(3) + total * (delta_vibration(machine).load_map(j) @ j)[0]
        own = np.sort(np.sqrt(K / np.linalg.eigvals(mass).real)) / (2 * np.pi)
        np.testing.assert_allclose(own, expected, atol=0.1)
        np.testing.assert_allclose(machine.vibration.modes_at(np.zeros(2)).frequencies_hz[:3], own, rtol=1e-6)


def test_the_papers_load_is_not_symmetric(as_printed: Machine) -> None:
    vibration, xy = delta_vibration(as_printed), as_printed.kinematics.rings(5, 24)
    j = as_printed.kinematics.jacobian(xy)
    load = vibration.load_map(j) @ j
    share = np.diagonal(load, axis1=1, axis2=2) / np.sum(j**2, axis=1)
    skew = np.linalg.norm(load - load.swapaxes(1, 2), axis=(1, 2)) / 2 / np.linalg.norm(load, axis=(1, 2))
    assert share.min() < 0.0 < 0.4 < share.max() and skew.max() == pytest.approx(0.31, abs=0.01)
