"""Named, with a rest: what holds most of a gap that nothing explains whole; never the nearest wrong effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.dominance import Dominant, dominant_effect
from ffcomp.diagnosis.fit import EstimationProblem, Fit, estimation_problem, fit
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.noise import noise_floor, whitener
from ffcomp.diagnosis.problem import Candidate, Observation, Parameter, Problem
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE

RATE_HZ, N, NOISE = 800.0, 1600, 0.01
PLACES = ((0.0, 0.0), (60.0, 50.0), (-70.0, -60.0), (40.0, -60.0))
T = np.arange(N) / RATE_HZ
WINDOW = np.sin(np.pi * T / T[-1]) ** 2


def tones(*hz: float) -> FloatArray:
    return np.asarray(WINDOW * sum(np.sin(2 * np.pi * f * T + f) for f in hz))


RUBS, BENDS, TOO = "coulomb_friction", "guide_damping", "belt_stiffness"
SIGNATURES = {
    RUBS: tones(7, 19, 31),
    BENDS: tones(11, 43),
    TOO: tones(7, 19, 31) + 0.1 * tones(40),
}
REST = tones(57, 71)  # nothing known makes it


def size_of(name: str) -> Parameter:
    return Parameter(f"effects.{name}.{CATALOGUE[name].amplitudes[0].name}", 0.0, 1.0)


class Linear(Problem):
    """A machine whose effects add; it has a rest that none of them makes. So is its second signal, if there is one."""

    band_hz = (1.0, 200.0)
    parameters: tuple[Parameter, ...] = (Parameter("gain", 1.0, 0.02),)
    motions: Sequence[int] = tuple(2 * (i // 2) for i in range(2 * len(PLACES)))  # each is recorded twice

    def __init__(self, sizes: Sequence[float], rest: float, names: Sequence[str], second: float = 0.0) -> None:
        rng, loud = np.random.default_rng(3), NOISE * np.ones(1 + bool(second))
        self.candidates = [Candidate(n, (size_of(n),), {size_of(n).name: 0.1}) for n in names]
        self.observations = [
            Observation(
                f"{k}-{n}.csv",
                f"{k}",
                place,
                RATE_HZ,
                ("acc_x", "acc_y")[: len(loud)],
                np.column_stack([size * SIGNATURES[RUBS] + rest * REST + tones(5, 23), second * REST][: len(loud)])
                + loud * rng.standard_normal((N, len(loud))),
                np.ones((N, len(loud))),
            )
            for k, (place, size) in enumerate(zip(PLACES, sizes, strict=True))
            for n in (1, 2)
        ]

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        y = values.get("gain", 1.0) * tones(5, 23)
        y = y + sum(values.get(size_of(n).name, 0.0) * s for n, s in SIGNATURES.items())
        both = np.column_stack([y, np.zeros(N)])[:, : len(self.observations[0].signals)]
        return [both] * len(range(len(self.observations)) if only is None else only)

    def only(self, chosen: Sequence[int]) -> Linear:
        part = copy(self)
        part.observations = [self.observations[i] for i in chosen]
        part.motions = [self.motions[i] for i in chosen]
        return part


def begun(problem: Problem) -> tuple[EstimationProblem, Fit]:
    """The problem with its noise, and its own parameter fitted alone."""
    whiten = whitener(problem.observations, noise_floor(problem), problem.band_hz)
    estimation = estimation_problem(problem, whiten)
    return estimation, fit(estimation, tuple(problem.parameters), np.zeros(len(problem.parameters)))


def dominant_of(problem: Linear) -> Dominant | None:
    estimation, base = begun(problem)
    own = tuple(problem.parameters)
    tried = [
        Hypothesis((c,), fit(estimation, (*own, *c.parameters), np.zeros(len(own) + 1))) for c in problem.candidates
    ]
    return dominant_effect(estimation, base, tried, lambda _: None)


def test_an_effect_that_leaves_a_rest_is_named_with_what_it_explains() -> None:
    """A quarter of the amplitude is of the rest: two tones of a half beside three."""
    found = dominant_of(Linear((1.0, 1.02, 0.98, 1.0), 0.5, (RUBS, BENDS)))
    assert found is not None and found.hypothesis.names == (RUBS,)
    assert found.explained == pytest.approx(1 - (2 * 0.5 / (3 + 2 * 0.5)) ** 2, abs=0.04)
    assert found.hypothesis.fit.values["effects.coulomb_friction.force_n"] == pytest.approx(1.0, abs=0.02)
    assert [rival.names for rival in found.rivals] == [(BENDS,)] and found.rivals[0].explained < 0.05


@pytest.mark.parametrize(
    ("sizes", "rest", "names"),
    [
        ((1.0, 0.0, 1.6, 0.2), 0.1, (RUBS, BENDS)),  # its size changes from place to place: something else does it
        ((1.0, 1.0, 1.0, 1.0), 5.0, (RUBS, BENDS)),  # more is left than it explains
        ((1.0, 1.0, 1.0, 1.0), 0.5, (RUBS, TOO)),  # another one explains as much
        ((3.0, 0.0, 0.0, 0.0), 0.1, (RUBS, BENDS)),  # at one place only
    ],
)
def test_what_is_only_the_nearest_is_not_named(sizes: Sequence[float], rest: float, names: Sequence[str]) -> None:
    assert dominant_of(Linear(sizes, rest, names)) is None


def test_what_explains_one_signal_is_named_in_it_where_each_is_compared_by_itself() -> None:
    problem = Linear((1.0, 1.02, 0.98, 1.0), 0.2, (RUBS, BENDS), second=8.0)
    assert dominant_of(problem) is None
    problem.forces = True
    found = dominant_of(problem)
    assert found is not None and found.hypothesis.names == (RUBS,) and found.signal == "acc_x"
    assert found.explained == pytest.approx(1 - (2 * 0.2 / (3 + 2 * 0.2)) ** 2, abs=0.04)


def test_a_copy_is_no_repeat_that_shows_the_noise() -> None:
    problem = Linear((1.0, 1.0, 1.0, 1.0), 0.0, (RUBS,))
    assert noise_floor(problem).from_repeats
    problem.observations = [*problem.observations[:1]] * 2
    assert not noise_floor(problem).from_repeats


def test_a_motion_that_no_simulation_follows_is_told_and_does_not_hide_the_effect() -> None:
    problem = Linear((1.0,) * len(PLACES), 0.0, (RUBS, BENDS))
    jumped = [replace(o, measured=o.measured - 4.0 * tones(5, 23)[:, None]) for o in problem.observations[-2:]]
    problem.observations = list(problem.observations[:-2]) + jumped
    found = diagnose(problem)
    assert found.named is not None
    assert found.named.names == (RUBS,)
    assert found.lost == [o.name for o in jumped]
