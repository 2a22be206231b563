"""The shapers' settings: found at least as good as calibrated, and their cost that of the motion they make."""

from __future__ import annotations

from functools import cache

import pytest

from ffcomp.comparison.baselines import LinearPrinter, Shaping, shaped
from ffcomp.comparison.sampling import Print, Sampling
from models.file import load_machine
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")


@cache
def linear() -> LinearPrinter:
    (stretch,), _ = Print(squares(), "squares.gcode", MACHINE).slices(Sampling(0, 0))
    return LinearPrinter(MACHINE, [stretch])


@pytest.mark.parametrize("name", ["mzv", "zv-z", "smooth_ei-z"])
def test_the_cost_of_settings_is_that_of_their_motion(name: str) -> None:
    shaping = Shaping.of(name)
    settings = linear().calibrated(shaping)
    assert shaping.name == name and len(settings) == len(shaping.names)
    (motion,) = (shaped(each.motion, *shaping.shapers(settings)) for each in linear().slices)
    assert linear().cost(shaping, settings) == pytest.approx(linear().contour_rms_um([motion]), rel=0.01)
