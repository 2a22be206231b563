"""The same delta in the words of three firmwares is the same machine, and moves as each firmware's formulas say."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from models.machine import Machine
from tests.support.configs import Delta, imported, written

PLACES = np.array([[0.0, 0.0, 5.0], [60.0, 10.0, 0.3], [-30.0, -50.0, 100.0], [1.0, 75.0, 20.0]])

eighths = st.integers(-16, 16).map(lambda n: n / 8)
deltas = st.builds(
    Delta,
    arms=st.tuples(*[st.integers(2000, 2400).map(lambda n: n / 8)] * 3),
    radius=st.integers(800, 1200).map(lambda n: n / 8),
    trims=st.tuples(eighths, eighths, eighths),
    print_radius=st.integers(640, 760).map(lambda n: n / 8),
    height=st.integers(1600, 3200).map(lambda n: n / 8),
    velocity=st.sampled_from([100.0, 150.0, 300.0]),
    acceleration=st.sampled_from([1000.0, 3000.0, 12000.0]),
    corner=st.sampled_from([1.0, 5.0, 12.5]),
    microsteps=st.sampled_from([8, 16, 32, 256]),
)


def numbers(machine: Machine) -> tuple[object, ...]:
    geometry, limits, steps = machine.kinematics, machine.limits, machine.steps
    return (
        [geometry.arm_lengths_mm, geometry.delta_radii_mm, geometry.tower_angles_deg, geometry.print_height_mm],
        [limits.velocity_mm_per_s, limits.acceleration_mm_per_s2, limits.square_corner_velocity_mm_per_s],
        [steps.steps_per_mm, steps.full_steps_per_mm],
    )


@settings(max_examples=20, deadline=None)
@given(delta=deltas)
def test_three_firmwares_one_machine(delta: Delta) -> None:
    with tempfile.TemporaryDirectory() as folder:
        texts = {"printer.cfg": delta.klipper(), "config.g": delta.reprapfirmware(), "m503.txt": delta.marlin()}
        klipper, duet, marlin = (imported(written(Path(folder), text, name)) for name, text in texts.items())
    assert klipper.kinematics.arm_lengths_mm.tolist() == list(delta.arms)
    for other in (duet, marlin):
        for ours, theirs in zip(numbers(klipper), numbers(other), strict=True):
            for one, two in zip(ours, theirs, strict=True):
                assert_allclose(one, two, rtol=1e-9)
    assert klipper.kinematics.print_radius_mm == duet.kinematics.print_radius_mm == delta.print_radius


def klipper_heights(delta: Delta, xyz: np.ndarray) -> np.ndarray:
    """Towers at radius · (cos, sin) of their angles."""
    angles = np.radians(np.array([210.0, 330.0, 90.0]) + delta.trims)
    return arms_up(delta, delta.radius * np.cos(angles), delta.radius * np.sin(angles), xyz)


def duet_heights(delta: Delta, xyz: np.ndarray) -> np.ndarray:
    """Towers seen from the front, back and sides: 30 degrees below the x axis, and on the y axis."""
    x, y, z = delta.trims
    a, b, c = np.radians(30 + x), np.radians(30 - y), np.radians(z)
    across = delta.radius * np.array([-np.cos(a), np.cos(b), -np.sin(c)])
    along = delta.radius * np.array([-np.sin(a), -np.sin(b), np.cos(c)])
    return arms_up(delta, across, along, xyz)


def arms_up(delta: Delta, across: np.ndarray, along: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    x, y, z = (column[:, None] for column in xyz.T)
    return z + np.sqrt(np.square(delta.arms) - (across - x) ** 2 - (along - y) ** 2)


@pytest.mark.parametrize(
    ("text", "heights"),
    [(Delta.klipper, klipper_heights), (Delta.reprapfirmware, duet_heights), (Delta.marlin, klipper_heights)],
)
def test_carriages_stand_where_the_firmware_puts_them(
    text: Callable[[Delta], str], heights: Callable[[Delta, np.ndarray], np.ndarray], tmp_path: Path
) -> None:
    delta = Delta(trims=(1.5, -2.0, 0.75), arms=(280.0, 283.0, 278.5))
    geometry = imported(written(tmp_path, text(delta))).kinematics
    ours = geometry.inverse(PLACES) - geometry.effector_height_mm
    assert_allclose(ours, heights(delta, PLACES), atol=1e-9)
