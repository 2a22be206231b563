"""Accuracy against effort: the bandwidth at the knee."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.inverse.settings import effort_curve, settings_for
from models.file import load_machine
from models.machine import Machine


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("mp-delta-pro")


@pytest.mark.parametrize("name", ["mp-delta-pro", "kossel", "flsun-qqs"])
def test_the_knee_lies_above_the_modes_that_ring(name: str) -> None:
    machine = load_machine(name)
    curve = effort_curve(machine, 0.004)
    found = machine.vibration.modes_at(np.zeros(2))
    slow = found.frequencies_hz[found.frequencies_hz < 90.0]
    assert curve.knee_hz > slow.max()
    settings = settings_for(machine)
    assert settings.inverse_hz == replace(settings, robust=True).inverse_hz == curve.knee_hz
