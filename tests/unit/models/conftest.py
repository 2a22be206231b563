"""Machines to test with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from models.arrays import constant
from models.file import load_machine
from models.kinematics.delta import DeltaKinematics
from models.machine import Machine, MotionLimits
from models.vibration.delta import DeltaVibration
from models.vibration.substructures import Carriage, Effector


def geometry(arm: float = 290.0, radius: float = 140.0, angles: tuple[float, ...] = (0, 120, 240)):
    return DeltaKinematics(
        constant([arm] * 3), constant([radius] * 3), constant(angles), 50.0, arm - radius - 15.0, 300.0
    )


@pytest.fixture
def rigid() -> Callable[..., Machine]:
    """An ideal drive, no damping, arms without mass, and 0.651 kg on the effector that do not flex."""

    def make(force_map: str = "virtual_work", offset: tuple[float, ...] = (0, 0, 0), **lengths) -> Machine:
        effector = Effector(0.542, 0.109, constant([1e12] * 3), constant([0] * 3), 39.91, constant(offset))
        kinematics, carriage = geometry(**lengths), Carriage(0.195, 0.0, 1.21e5, 0.0, 0.0)
        vibration = DeltaVibration(carriage, replace(effector, force_map=force_map), kinematics)
        return Machine("rigid", kinematics, vibration, MotionLimits(300.0, 10000.0))

    return make


@pytest.fixture(scope="session")
def printer() -> Machine:
    return load_machine("mp-delta-pro")


@pytest.fixture(scope="session")
def as_printed() -> Machine:
    return load_machine("mp-delta-pro-as-printed")


@pytest.fixture
def bed() -> np.ndarray:
    """(40, 2) mm, places all over a bed of 120 mm radius, fixed."""
    generator = np.random.default_rng(3)
    radius, angle = 120 * np.sqrt(generator.random(40)), 2 * np.pi * generator.random(40)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
