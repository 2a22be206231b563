"""Delta kinematics: closed forms, round trips, finite differences, symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.arrays import constant
from models.errors import UnreachableError
from models.kinematics.delta import DeltaKinematics

SYMMETRIC = DeltaKinematics(
    constant([300.0] * 3), constant([140.0] * 3), constant([0.0, 120.0, 240.0]), 50.0, 135.0, 300.0
)
CROOKED = DeltaKinematics(
    constant([300.0, 301.5, 298.2]), constant([140.0, 141.1, 139.2]), constant([29.0, 151.5, 270.3]), 50.0, 135.0, 300.0
)


@st.composite
def geometries(draw) -> DeltaKinematics:
    """Printers from desk to door size, each tower a little off."""
    radius = draw(st.floats(60, 400))
    print_radius = radius * draw(st.floats(0.5, 1.0))
    arm = (radius + print_radius) * draw(st.floats(1.03, 1.5))
    off = st.lists(st.floats(-1, 1), min_size=3, max_size=3).map(np.array)
    angles = np.array([0.0, 120.0, 240.0]) + draw(st.floats(-180, 180)) + 3 * draw(off)
    radii, arms = radius * (1 + 0.005 * draw(off)), arm * (1 + 0.005 * draw(off))
    return DeltaKinematics(constant(arms), constant(radii), constant(angles), 40.0, print_radius, 2 * radius)


def places(geometry: DeltaKinematics, count: int = 50) -> np.ndarray:
    """(count, 3) mm over the whole print volume."""
    generator = np.random.default_rng(count)
    radius = geometry.print_radius_mm * np.sqrt(generator.random(count))
    angle, z = 2 * np.pi * generator.random(count), geometry.print_height_mm * generator.random(count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])


@given(geometries())
@settings(max_examples=40, deadline=None)
def test_forward_undoes_inverse(geometry: DeltaKinematics) -> None:
    xyz = places(geometry)
    np.testing.assert_allclose(geometry.forward(geometry.inverse(xyz)), xyz, rtol=0, atol=1e-9)


@given(geometries())
@settings(max_examples=20, deadline=None)
def test_every_arm_keeps_its_length(geometry: DeltaKinematics) -> None:
    xyz = places(geometry)
    q = geometry.inverse(xyz)
    across = xyz[:, None, :2] - geometry.towers_mm
    rise = q - (xyz[:, 2:] + geometry.effector_height_mm)
    np.testing.assert_allclose(
        np.hypot(np.hypot(across[..., 0], across[..., 1]), rise), np.tile(geometry.arm_lengths_mm, (50, 1)), rtol=1e-13
    )
    assert np.all(rise > 0)  # carriages above the effector, not the mirrored solution


@given(geometries())
@settings(max_examples=20, deadline=None)
def test_jacobian_agrees_with_finite_differences(geometry: DeltaKinematics) -> None:
    xyz, step = places(geometry), 1e-3
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        dq = (geometry.inverse(xyz + offset) - geometry.inverse(xyz - offset)) / (2 * step)
        moved = np.einsum("nij,nj->ni", geometry.jacobian(xyz[:, :2]), dq)
        np.testing.assert_allclose(moved, np.tile(np.eye(3)[axis], (50, 1)), atol=2e-6)


def test_centre_of_a_symmetric_delta_in_closed_form() -> None:
    singular = np.linalg.svd(SYMMETRIC.jacobian(np.zeros((1, 2)))[0], compute_uv=False)
    h_over_r = np.sqrt(300.0**2 - 140.0**2) / 140.0
    np.testing.assert_allclose(singular**2, [2 / 3 * h_over_r**2, 2 / 3 * h_over_r**2, 1 / 3], rtol=1e-12)


def test_jacobian_turns_with_the_machine() -> None:
    """By 120 degrees, what A did B does."""
    c, s = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    xy = places(SYMMETRIC)[:, :2]
    turned = SYMMETRIC.jacobian(xy @ turn[:2, :2].T)
    np.testing.assert_allclose(turned, turn @ SYMMETRIC.jacobian(xy)[:, :, [2, 0, 1]], atol=1e-12)


def _curve(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity, acceleration of a helix off the centre, (n, 3) each."""
    w, r = 9.0, 35.0
    x = np.column_stack([40 + r * np.cos(w * t), -30 + r * np.sin(w * t), 60 + 4 * np.sin(3 * t)])
    v = np.column_stack([-r * w * np.sin(w * t), r * w * np.cos(w * t), 12 * np.cos(3 * t)])
    a = np.column_stack([-r * w**2 * np.cos(w * t), -r * w**2 * np.sin(w * t), -36 * np.sin(3 * t)])
    return x, v, a


def test_rate_term_is_what_carriage_accelerations_leave() -> None:
    """Ẍ − J q̈, with q̈ by differences of fourth order along a helix."""
    t, step = np.linspace(0, 2, 60), 1e-3
    q = [CROOKED.inverse(_curve(t + k * step)[0]) for k in (-2, -1, 0, 1, 2)]
    q_acceleration = (-q[0] + 16 * q[1] - 30 * q[2] + 16 * q[3] - q[4]) / (12 * step**2)
    x, v, a = _curve(t)
    left = a - np.einsum("nij,nj->ni", CROOKED.jacobian(x), q_acceleration)
    term = CROOKED.compiled().rate_term(x, v)
    assert np.abs(term).max() > 100  # mm/s²: not a test of zeros
    np.testing.assert_allclose(term, left, atol=1e-3)


def test_points_too_far_for_an_arm_are_named() -> None:
    xyz = np.array([[0.0, 0.0, 5.0], [0.0, 280.0, 5.0], [1.0, 2.0, 5.0], [-300.0, 0.0, 5.0]])
    with pytest.raises(UnreachableError, match=r"X = 0\.000, Y = 280\.000 .*1 more point") as caught:
        SYMMETRIC.inverse(xyz)
    assert caught.value.indices.tolist() == [1, 3]


@pytest.mark.parametrize(
    ("point", "rule"),
    [
        ((100.0, 100.0, 5.0), "print radius of 135 mm"),
        ((0.0, 0.0, 300.1), "print height of 300 mm"),
        ((0.0, 0.0, -5.1), "below the bed"),
    ],
)
def test_points_outside_the_print_volume_are_refused(point: tuple[float, ...], rule: str) -> None:
    with pytest.raises(UnreachableError, match=rule) as caught:
        SYMMETRIC.check_reach(np.array([[0.0, 0.0, 1.0], point]))
    assert caught.value.indices.tolist() == [1]
