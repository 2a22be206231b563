"""The parts of the diagnosis by themselves: derivatives, what runs must be; and a measured axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.diagnosis.fit import EstimationProblem, derivatives
from ffcomp.diagnosis.noise import NoiseFloor, whitener
from ffcomp.diagnosis.problem import Candidate, Observation, Parameter, Problem

# ---- fit -----------------------------------------------------------------------------------------


@dataclass
class Line(Problem):
    """y = (a + b) t² + a³ t, a toy problem."""

    band_hz: tuple[float, float] = (1.0, 40.0)
    observations: Sequence[Observation] = ()
    parameters: Sequence[Parameter] = (Parameter("a", 1.0, 0.5), Parameter("b", 0.0, 0.5, 0.0, 2.0))
    candidates: Sequence[Candidate] = field(default_factory=tuple)

    def simulate(
        self, values: Mapping[str, float], only: Sequence[int] | None = None, *, coarse: bool = False
    ) -> list[np.ndarray]:
        a, b = values.get("a", 1.0), values.get("b", 0.0)
        t = np.arange(200)[:, None] / 200
        return [np.asarray((a + b) * t**2 + a**3 * t) for _ in self.observations]


def toy(a: float, b: float) -> EstimationProblem:
    problem = Line()
    blank = Observation("x", "x", (0.0,), 200.0, ("acc_A",), np.zeros((200, 1)), np.zeros((200, 1)))
    problem.observations = [blank]
    measured = problem.simulate({"a": a, "b": b})
    problem.observations = [replace(blank, measured=measured[0])]
    floor = NoiseFloor(np.array([0.0, 100.0]), {"acc_A": np.full(2, 1e-10)}, True)
    whiten = whitener(problem.observations, floor, problem.band_hz)
    return EstimationProblem(problem, whiten, whiten(measured))


def test_derivatives_are_exact_where_central_and_zero_for_a_parameter_that_cannot_move() -> None:
    estimation, z = toy(1.0, 0.0), np.array([0.3, 0.0])
    parameters = (Parameter("a", 1.0, 0.5), Parameter("fixed", 0.0, 1.0, 0.0, 0.0))
    residual = estimation.residual({"a": 1.15})
    rough = derivatives(estimation, parameters, z, residual, [0, 1])
    sizes = np.linalg.norm(rough, axis=0)
    fine = derivatives(estimation, parameters, z, residual, [0, 1], central=True, sizes=sizes)
    t = np.arange(200)[:, None] / 200
    exact = estimation.whiten([0.5 * (t**2 + 3 * 1.15**2 * t)])
    assert np.linalg.norm(fine[:, 0] - exact) < 1e-5 * np.linalg.norm(exact)
    assert not fine[:, 1].any() and not rough[:, 1].any()


# ---- what runs must be ---------------------------------------------------------------------------
