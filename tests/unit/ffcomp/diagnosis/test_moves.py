"""The moves of the search: what is set free."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.fit import Fit
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.moves import free_shapes
from ffcomp.diagnosis.problem import Candidate, Parameter

LONG = 20_000


@dataclass(frozen=True)
class Linear:
    """A problem whose simulation is linear in its parameters, of one motion."""

    measured: np.ndarray
    columns: Mapping[str, np.ndarray]
    coarse: bool = False
    only: tuple[int, ...] = (0,)
    may_go_on: bool = True

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        return np.asarray(self.measured - sum(values.get(n, 0.0) * column for n, column in self.columns.items()))

    def residuals(self, many: Sequence[Mapping[str, float]]) -> Iterator[np.ndarray]:
        return map(self.residual, many)


def test_a_usual_shape_that_bends_the_numbers_beside_it_is_set_free() -> None:
    """A sine without the belt's share fits nearly as well with a wrong amplitude: its interval would lie."""
    rng = np.random.default_rng(5)
    size, share = Parameter("effects.sine.size", 0.0, 10.0), Parameter("effects.sine.share", 0.0, 1.0)
    along, across = rng.standard_normal((2, LONG))
    columns = {size.name: along, share.name: 0.2 * along + 0.05 * across}
    sine = Candidate("sine", (size,), {}, finer=(share,))

    def explained(shared: float) -> Hypothesis:
        measured = rng.standard_normal(LONG) + 3.0 * along + shared * columns[share.name]
        problem: Any = Linear(measured, columns)
        alone = 10.0 * along[:, None]
        z = np.linalg.lstsq(alone, measured, rcond=None)[0]
        held = Hypothesis((sine,), Fit((size,), z, measured - alone @ z, alone))
        return free_shapes(problem, held, lambda _: None)

    freed = explained(2.0)
    assert freed.fit.values[size.name] == pytest.approx(3.0, abs=0.1)
    assert freed.fit.values[share.name] == pytest.approx(2.0, abs=0.4)
    assert explained(0.0).effects == (sine,)  # nothing asks for it
