"""The shapers' settings: found at least as good as calibrated, and their cost that of the motion they make."""

from __future__ import annotations

from functools import cache

import pytest

from ffcomp.comparison.methods import LinearPrinter, Shaping, shaped
from ffcomp.comparison.sampling import Print, PrintSlice, Sampling
from ffcomp.simulation.expectation import Commanded
from models.file import load_machine
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")


@cache
def part() -> PrintSlice:
    (first_layer,), _ = Print(squares(), "squares.gcode", MACHINE).slices(Sampling(0, 0))
    return first_layer


@cache
def linear() -> LinearPrinter:
    return LinearPrinter(MACHINE, [part()])


@pytest.mark.parametrize("name", ["mzv", "zv-z", "smooth_ei-z"])
def test_the_cost_of_settings_is_that_of_their_motion(name: str) -> None:
    shaping = Shaping.of(name)
    settings = linear().calibrated(shaping)
    assert shaping.name == name and len(settings) == len(shaping.names)
    motion = shaped(part().motion, *shaping.shapers(settings))
    executed = linear().contour_rms_um(lambda piece: Commanded(motion.position(piece.due), piece.due))
    assert linear().cost(shaping, settings) == pytest.approx(executed, rel=0.01)
