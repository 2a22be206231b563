"""What is left out of a fit says nothing of the machine by its clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ffcomp.diagnosis.fit import estimation_problem, fit
from ffcomp.diagnosis.held_out import hold_out
from ffcomp.diagnosis.noise import noise_from_repeats, whitener
from ffcomp.diagnosis.problem import Observation, Parameter, Problem
from ffcomp.diagnosis.recording_clocks import PREFIX, as_recorded
from ffcomp.numerics.delay import delayed
from models.arrays import FloatArray

RATE_HZ, N, NOISE, LATE_S = 1600.0, 2400, 0.02, 1.2e-3
DELAY, SIZE = "effects.command_delay.delay_s", "size"
PLACES = ((0.0, 0.0), (60.0, 50.0), (-70.0, -60.0))


def felt() -> FloatArray:
    t = np.arange(N) / RATE_HZ
    window = np.where((t > 0.1) & (t < 1.2), np.sin(np.pi * (t - 0.1) / 1.1) ** 2, 0.0)
    return (window * sum(np.sin(2 * np.pi * f * t + f) for f in (6.0, 17.0, 29.0, 48.0)))[:, None]


class Late(Problem):
    """A machine that follows late, and may be of another size; each place is recorded twice, on clocks in doubt."""

    band_hz = (1.0, 200.0)
    candidates, name, path, recordings = (), "late", "", ()

    def __init__(self, size_at_last: float = 1.0) -> None:
        rng = np.random.default_rng(3)
        sizes = (1.0, 1.0, size_at_last)
        self.observations = [
            Observation(
                f"{k}-{n}.csv", f"{k}", place, RATE_HZ, ("acc_x",), _noisy(sizes[k] * felt(), rng), np.ones((N, 1))
            )
            for k, place in enumerate(PLACES)
            for n in (1, 2)
        ]
        self.parameters = (
            Parameter(SIZE, 1.0, 0.1),
            *(Parameter(f"{PREFIX}{k}.delay_s", 0.0, 3e-4) for k in range(len(PLACES))),
        )

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[FloatArray]:
        late = values.get(SIZE, 1.0) * delayed(felt(), values.get(DELAY, 0.0), RATE_HZ)
        chosen = range(len(self.observations)) if only is None else only
        return [as_recorded(values, self.observations[i], late) for i in chosen]


def _noisy(x: FloatArray, rng: np.random.Generator) -> FloatArray:
    return delayed(x, LATE_S, RATE_HZ) + NOISE * rng.standard_normal(x.shape)


def left_out(problem: Problem) -> list[float]:
    floor = noise_from_repeats(problem.observations)
    assert floor is not None
    estimation = estimation_problem(problem, whitener(problem.observations, floor, problem.band_hz))
    parameters = (*problem.parameters, Parameter(DELAY, 0.0, 3e-4, 0.0, 5e-3))
    fits = [fit(estimation, p, np.zeros(len(p)), iterations=10) for p in (problem.parameters, parameters)]
    # the machine has a part of the delay only: three recordings have the rest, two would have more of it
    assert 0.6 * LATE_S < fits[1].values[DELAY] < LATE_S
    return [place.after for place in hold_out(estimation, *fits)]


def test_recordings_left_out_keep_clocks_of_their_own() -> None:
    assert max(left_out(Late())) < 0.1


def test_a_clock_hides_no_other_error_of_what_was_left_out() -> None:
    assert left_out(Late(size_at_last=1.3))[-1] > 1.0
