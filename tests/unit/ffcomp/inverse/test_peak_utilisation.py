"""The peak of a command's demand is the largest of all its utilisations."""

from __future__ import annotations

import numpy as np

from ffcomp.inverse.command_limits import CommandLimits, peak_utilisation
from models.file import load_machine


def test_peak_out_of_reach_is_no_number() -> None:
    """What an arm cannot reach must not pass as a small demand."""
    limits = CommandLimits.of(load_machine("mp-delta-pro"), 0.004)
    vertices = np.array([[0.0, 0.0, 10.0], [900.0, 0.0, 10.0], [0.0, 0.0, 10.0]])
    assert np.isnan(peak_utilisation(vertices, limits))
