"""What a hypothesis must pass: little left in both units, modes that swing; and how well a size is known at best."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.acceptance import rejections, undetermined
from ffcomp.diagnosis.fit import FORMULA_ERROR, Fit, intervals_of
from ffcomp.diagnosis.held_out import HeldOut, left_of
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.problem import Candidate, Parameter
from ffcomp.diagnosis.settings import SearchSettings
from ffcomp.identification.uncertainty import NINETY_PERCENT, Estimate

MASS = Parameter("effects.frame_mode.mass_kg", 0.0, 0.1, 0.0, 10.0)
DAMPING = Parameter("effects.frame_mode.damping_ratio", 0.03, 0.05, 0.0, 1.0)
ROWS = 400


def frame_mode(z: tuple[float, float]) -> Hypothesis:
    rng = np.random.default_rng(1)
    fitted = Fit((MASS, DAMPING), np.array(z), rng.standard_normal(ROWS), 1e4 * rng.standard_normal((ROWS, 2)))
    return Hypothesis((Candidate("frame_mode", (MASS,), {MASS.name: 1.0}, (DAMPING,)),), fitted)


def test_what_is_left_counts_in_units_of_noise_and_of_signals() -> None:
    """A stiff belt took the loud line away, 6 % of |r|² was left, and 40 % of the motion's power: it was named."""
    place = {"position": (0.0, 0.0), "experiment": "", "rows": 100, "before": 1000.0, "filed": 1000.0}
    loud_line = HeldOut(**place, after=60.0, power=(1.0, 0.41, 1.2, 0.01))
    assert left_of([loud_line]) == pytest.approx(0.40 / 0.99)
    loud_noise = HeldOut(**place, after=400.0, power=(1.0, 0.07, 1.2, 0.01))
    assert left_of([loud_noise]) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("scatter", "after", "z", "said"),
    [
        (1.0, [], 0.0, "it was tested nowhere else: there is one experiment only"),
        (1.0, [999.9], 0.0, "data left out of the fit are simulated no better with it than by chance"),  # 10 of 10.6
        (1e4, [10.0], 0.0, "data left out of the fit are simulated no better with it than by chance"),
        (1.0, [400.0], 0.0, "40 % of the discrepancy is left where it was left out of the fit"),
        (1.0, [10.0], 1.9, ""),  # ten numbers: once in 12 000 machines by chance; 2.0 once in 59 000
        (1.0, [10.0], 2.0, "the file's numbers would have to be off further than their uncertainties together allow"),
    ],
)
def test_what_a_hypothesis_fails_by(scatter: float, after: list[float], z: float, said: str) -> None:
    mode = frame_mode((3.0, 1.0)).effects[0]
    problem = SimpleNamespace(candidates=[mode, replace(mode, name="arm_inertia")])
    estimation: Any = SimpleNamespace(settings=SearchSettings(), tolerance=1.0, problem=problem)
    numbers = tuple(Parameter(f"carriage.number_{i}", 1.0, 0.02) for i in range(10))
    fit: Any = SimpleNamespace(overdispersion=scatter, parameters=numbers, z=np.full(10, z))
    best: Any = SimpleNamespace(fit=fit, effects=(), effect_parameters=(), may_leave=lambda share, _: share)
    held_out = [HeldOut((0.0, 0.0), "", 100, 1e3, x, 1e3, power=(1.0, x / 1e3, 1.2, 0.0)) for x in after]
    assert rejections(estimation, best, held_out, {}) == [said] * bool(said)


@pytest.mark.parametrize(("ratio", "refused"), [(0.06, False), (1.0, True)])
def test_a_mode_that_is_damped_as_much_as_it_can_be_does_not_swing(ratio: float, refused: bool) -> None:
    h = frame_mode((3.0, (ratio - DAMPING.start) / DAMPING.sd))
    intervals = {n.name: Estimate(x, 0.01, x - 0.01, x + 0.01) for n, x in ((MASS, 0.3), (DAMPING, ratio))}
    found = undetermined(h, intervals)
    assert bool(found) == refused
    assert [n.name for n in found] == ["effects.frame_mode.damping_ratio"] * refused


@pytest.mark.parametrize(("effect", "share"), [("frame_mode", 0.05), ("sensor_gain", 0.002), ("command_delay", 0.002)])
def test_an_effect_of_one_law_may_leave_hardly_anything(effect: str, share: float) -> None:
    h = frame_mode((3.0, 1.0))
    assert replace(h, effects=(replace(h.effects[0], name=effect),)).may_leave(0.05, SearchSettings()) == share


def test_an_effects_size_is_never_known_better_than_its_formula() -> None:
    h = frame_mode((3.0, 1.0))
    blocks = np.repeat(np.arange(40), ROWS // 40)
    estimation: Any = SimpleNamespace(blocks=blocks, motions=0 * blocks)
    size, shape = (intervals_of(estimation, h.fit)[n.name] for n in (MASS, DAMPING))
    assert size.high - size.value == pytest.approx(NINETY_PERCENT * FORMULA_ERROR * size.value, rel=1e-3)
    assert shape.high - shape.value < 1e-3 * shape.value
