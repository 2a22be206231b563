"""Fits that are held within what the file says, and fits that come back to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.acceptance import out_of_reach
from ffcomp.diagnosis.diagnosis import _fitted_to_the_end, _needed
from ffcomp.diagnosis.fidelity import (
    fit_within_uncertainty,
)
from ffcomp.diagnosis.fit import Fit, values_at
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.noise import NoiseFloor
from ffcomp.diagnosis.problem import Candidate, Parameter
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.diagnosis.trace import Trace

LONG = 20_000


@dataclass(frozen=True)
class Linear:
    """A problem whose simulation is linear in its parameters, of one motion."""

    measured: np.ndarray
    columns: Mapping[str, np.ndarray]
    coarse: bool = False
    block_rows: float = 1.0

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        return np.asarray(self.measured - sum(values.get(n, 0.0) * column for n, column in self.columns.items()))

    def residuals(self, many: Sequence[Mapping[str, float]]) -> Iterator[np.ndarray]:
        return map(self.residual, many)


def test_numbers_that_make_up_for_each_other_come_back_before_an_effect_is_named_for_it() -> None:
    """Mass and stiffness four uncertainties off leave nothing, as they do at home: no effect is needed."""
    rng = np.random.default_rng(2)
    both = rng.standard_normal(LONG)
    columns = {"mass": 3.0 * both, "belt": -3.0 * both}
    own = tuple(Parameter(n, 0.0, 1.0, -5.0, 5.0) for n in columns)
    problem: Any = Linear(rng.standard_normal(LONG), columns)
    z = np.array([4.0, 4.0])
    jacobian = np.stack(list(columns.values()), axis=1)
    astray = Fit(own, z, next(problem.residuals([values_at(own, z)])), jacobian)
    assert np.abs(_fitted_to_the_end(problem, astray, 0.1).z).max() < 0.1
    loud = replace(astray, residual=astray.residual + 3.0 * rng.standard_normal(LONG))
    assert _fitted_to_the_end(problem, loud, 0.1) is loud  # it leaves something that they cannot explain


def test_numbers_of_the_file_are_held_within_reach_where_an_effect_explains_as_much() -> None:
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((2, LONG))
    stiffness, delay = Parameter("belt", 1.0, 0.02), Parameter("effects.command_delay.delay_s", 0.0, 1.0)
    measured = rng.standard_normal(LONG) + columns[1] * 5.0 - columns[0] * 0.05  # as if it were 2.5 of its sd off

    def residuals(many: Sequence[Mapping[str, float]]) -> Iterator[np.ndarray]:
        for v in many:
            yield measured - columns[0] * (v[stiffness.name] - 1.0) - columns[1] * v[delay.name]

    problem: Any = SimpleNamespace(
        residuals=residuals,
        residual=lambda v: next(residuals([v])),
        coarse=True,
        block_rows=1.0,
        settings=SETTINGS,
        trace=Trace(),
    )
    z = np.array([-4.0, 5.0])
    begun = Fit((stiffness, delay), z, next(residuals([values_at((stiffness, delay), z)])), columns.T * [0.02, 1.0])
    best = Hypothesis((Candidate("command_delay", (delay,), {}),), begun)
    held = fit_within_uncertainty(problem, best, lambda _: None)
    assert out_of_reach(best) and not out_of_reach(held)
    assert held.fit.z[0] == pytest.approx(-np.sqrt(3.0)) and held.fit.z[1] == pytest.approx(5.0, abs=0.05)
    assert held.discrepancy < 0.05


def test_numbers_far_beyond_what_the_file_says_are_no_better_file() -> None:
    """By a noise that is guessed an effect must leave 5 % less; but not if the file would be off by 4.9 of its sd."""
    number, size = Parameter("axis.stiffness", 1.0, 0.02), Parameter("effects.belt.change", 0.0, 0.1)
    belt, rows = Candidate("belt", (size,), {}), np.full(900, 1.0)
    best = Hypothesis((belt,), Fit((number, size), np.array([0.3, 1.0]), rows, np.ones((900, 2))))
    floor = NoiseFloor(np.array([0.0, 800.0]), {}, from_repeats=False)
    guessed: Any = SimpleNamespace(settings=SETTINGS, whiten=SimpleNamespace(floor=floor))
    for z, needed in ((1.5, False), (4.9, True)):
        retuned = Fit((number,), np.array([z]), 1.02 * rows, np.ones((900, 1)))
        assert _needed(guessed, best, retuned) is needed
