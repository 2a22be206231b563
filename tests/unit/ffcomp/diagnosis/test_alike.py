"""Effects that do much the same: beside others, and in place of a number of the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import diagnose
from ffcomp.diagnosis.fit import estimation_problem, fit
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.moves import Search, _like_the_furthest
from ffcomp.diagnosis.noise import noise_from_repeats, whitener
from ffcomp.diagnosis.problem import Candidate, Observation, Parameter, Problem
from models.arrays import FloatArray

RATE_HZ, N, NOISE = 800.0, 1600, 0.01
PLACES = ((0.0, 0.0), (60.0, 50.0), (-70.0, -60.0))
T = np.arange(N) / RATE_HZ


def tones(*hz: float) -> FloatArray:
    return np.asarray(np.sin(np.pi * T / T[-1]) ** 2 * sum(np.sin(2 * np.pi * f * T + f) for f in hz))


GAIN, MASS = tones(5, 23), tones(61)  # what two numbers of the file do
SIGNATURES = {
    "sensor_time_offset": tones(7, 19, 31),
    "belt_damping": tones(7, 19, 31) + 0.0035 * tones(40),
    "sensor_gain": tones(11, 43) - 0.014 * tones(40),
    "effector_mass": 2.0 * MASS,
    "guide_damping": MASS + tones(53),
}


def size_of(name: str) -> Parameter:
    return Parameter(f"effects.{name}.size", 0.0, 1.0)


class Adding(Problem):
    """A machine whose effects add."""

    band_hz = (1.0, 200.0)
    name, path, recordings = "adding", "", ()
    parameters = (Parameter("gain", 1.0, 0.02), Parameter("mass", 1.0, 0.02))
    motions = tuple(2 * (i // 2) for i in range(2 * len(PLACES)))  # each is recorded twice

    def __init__(self, names: Sequence[str], hidden: Mapping[str, float]) -> None:
        rng = np.random.default_rng(5)
        self.candidates = [Candidate(n, (size_of(n),), {size_of(n).name: 0.1}) for n in names]
        self.observations = []
        true = self.simulate({size_of(n).name: x for n, x in hidden.items()}, [0])[0]
        for k, place in enumerate(PLACES):
            for n in (1, 2):
                felt = true + NOISE * rng.standard_normal((N, 1))
                named = (f"{k}-{n}.csv", f"{k}", place, RATE_HZ, ("acc_x",))
                self.observations.append(Observation(*named, felt, np.ones((N, 1))))

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        y = values.get("gain", 1.0) * GAIN + values.get("mass", 1.0) * MASS
        y = y + sum(values.get(size_of(n).name, 0.0) * s for n, s in SIGNATURES.items())
        return [y[:, None]] * len(range(len(self.observations)) if only is None else only)


def test_what_is_confounded_with_an_effect_is_tried_beside_the_others() -> None:
    """An offset explains more alone than the belts do, which with a gain explain all."""
    found = diagnose(Adding(tuple(SIGNATURES)[:3], {"belt_damping": 1.0, "sensor_gain": 0.25}))
    assert found.named is not None and found.named.names == ("belt_damping", "sensor_gain")


@pytest.mark.parametrize(("names", "alike"), [(SIGNATURES, "effector_mass"), (["guide_damping"], "")])
def test_the_effect_is_found_that_does_what_a_number_of_the_file_did(names: Sequence[str], alike: str) -> None:
    problem = Adding(tuple(names), {"effector_mass": 0.05})
    floor = noise_from_repeats(problem.observations)
    assert floor is not None
    estimation = estimation_problem(problem, whitener(problem.observations, floor, problem.band_hz))
    bent = fit(estimation, tuple(problem.parameters), np.zeros(2))
    search = Search(estimation, (), bent, lambda _: None)
    assert _like_the_furthest(search, Hypothesis((), bent), problem.candidates) == alike
