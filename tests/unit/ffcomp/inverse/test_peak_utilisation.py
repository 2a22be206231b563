"""The peak of a command's demand is the largest of all its utilisations."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.inverse.command_limits import CommandLimits, peak_utilisation, utilisation_from_rest
from models.file import load_machine


@pytest.mark.parametrize("name", ["mp-delta-pro", "voron-300"])
def test_peak_is_the_largest_utilisation(name: str) -> None:
    """Scanned without arrays between, the peak is the same to the last bit."""
    limits = CommandLimits.of(load_machine(name), 0.004)
    rng = np.random.default_rng(5)
    for knots in (1, 2, 3, 50):
        for amplitude in (0.0, 0.01, 1.0):
            vertices = np.array([20.0, 10.0, 30.0]) + amplitude * np.cumsum(rng.normal(size=(knots, 3)), axis=0)
            assert peak_utilisation(vertices, limits) == utilisation_from_rest(vertices, limits).max()


def test_peak_out_of_reach_is_no_number() -> None:
    """What an arm cannot reach must not pass as a small demand."""
    limits = CommandLimits.of(load_machine("mp-delta-pro"), 0.004)
    vertices = np.array([[0.0, 0.0, 10.0], [900.0, 0.0, 10.0], [0.0, 0.0, 10.0]])
    assert np.isnan(peak_utilisation(vertices, limits))
