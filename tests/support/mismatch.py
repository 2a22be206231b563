"""A small mismatch study, by as many processes as a test likes."""

from __future__ import annotations

from functools import cache
from unittest.mock import patch

from ffcomp import shapers
from ffcomp.comparison import methods as every
from ffcomp.comparison.baselines import LinearPrinter, shaped
from ffcomp.comparison.evaluation import Stages
from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.monte_carlo import ON_PLANTS, TUNING_ON_PLANTS, with_spread
from ffcomp.comparison.result import Spread
from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.compensation.batch import workers
from ffcomp.inverse.settings import settings_for
from ffcomp.simulation.expectation import draw_plants
from models.file import load_machine
from tests.support.comparison import method
from tests.support.prints import squares

SEEDS = 3
MACHINE = load_machine("mp-delta-pro")


@cache
def tuned() -> list[TunedMethod]:
    """One method of each kind that is commanded in another way, without a search."""
    zv = shapers.zv(40.0)
    return [
        every.none(),
        every.calibrated(LinearPrinter(MACHINE, []), "mzv"),
        TunedMethod("zv", "", "best fixed", "", lambda s: (shaped(s.motion, zv, zv), None)),
        every.inversion(MACHINE, settings_for(MACHINE), every.COMPENSATED),
    ]


@cache
def study(jobs: int = 1) -> tuple[dict[str, tuple[Spread | None, Spread | None]], list[float]]:
    """Each method's numbers as it was tuned and tuned anew, and the progress that was told.

    Of three plants two go side by side, so that each method is two tasks.
    """
    told: list[float] = []
    progress = Stages(lambda what, share: told.append(share), {ON_PLANTS: 1.0, TUNING_ON_PLANTS: 1.0})
    slices, _ = Print(squares(1), "squares.gcode", MACHINE).slices(Sampling())
    methods = {each.name: method(each.name, each.label, each.family, 1.0) for each in tuned()}
    methods["mzv"] = method("mzv", "MZV", "best fixed", 1.0)
    plants = draw_plants(MACHINE, 0.1, SEEDS)
    with patch("ffcomp.comparison.monte_carlo.LANES", 2), workers(jobs) as at_once:
        found = with_spread(methods, tuned(), "mzv", slices, slices, plants, at_once, progress)
    return {name: (each.spread, each.retuned) for name, each in found.items()}, told
