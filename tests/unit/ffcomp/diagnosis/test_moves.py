"""The moves of the search: the forms of an effect, what is set free, what is dropped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.fit import Fit
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.moves import ALTERNATIVE, FREED, SHAPE_CHANGES, USUAL, _started_richer, free_shapes
from ffcomp.diagnosis.problem import Candidate, Parameter

LONG = 20_000


def number(name: str) -> Parameter:
    return Parameter(f"effects.coulomb_friction.{name}", 0.0, 1.0)


SPEED = (number("creep_mm_per_s"), number("hold_per_s"))
EACH = Candidate(
    "coulomb_friction",
    tuple(number(f"force_n[{i}]") for i in range(2)),
    {},
    finer=SPEED,
    alternative=tuple(number(f"presliding_mm[{i}]") for i in range(2)),
)
FRICTION = Candidate(
    "coulomb_friction", (number("force_n"),), {}, finer=SPEED, alternative=(number("presliding_mm"),), other=EACH
)
OTHER, FIRST = (change.change for change in SHAPE_CHANGES)


def test_friction_bends_instead_of_creeping_and_the_other_way_round() -> None:
    for first in (FRICTION, EACH):
        bent = ALTERNATIVE.change(FREED.change(first, FRICTION), FRICTION)
        assert bent.shapes == first.alternative and not bent.finer and bent.amplitudes == first.amplitudes
        assert ALTERNATIVE.change(bent, FRICTION) is bent and FREED.change(bent, FRICTION) is bent
        assert USUAL.change(bent, FRICTION).shapes == SPEED


def test_another_number_of_forces_is_of_the_same_kind() -> None:
    bent = ALTERNATIVE.change(FRICTION, FRICTION)
    each = OTHER(bent, FRICTION)
    assert each.amplitudes == EACH.amplitudes and each.shapes == EACH.alternative
    assert FIRST(each, FRICTION).parameters == bent.parameters
    creeping = OTHER(FREED.change(FRICTION, FRICTION), FRICTION)
    assert creeping.shapes == SPEED and FIRST(creeping, FRICTION).shapes == SPEED


def test_an_effect_of_one_kind_has_no_other() -> None:
    plain = replace(FRICTION, alternative=(), other=replace(EACH, alternative=()))
    assert ALTERNATIVE.change(plain, plain) is plain and USUAL.change(plain, plain) is plain
    assert OTHER(plain, plain).amplitudes == EACH.amplitudes


class Nearest:
    """A problem whose error is how far the new numbers of fading friction are from 0.3 of the old ones, and 1."""

    def residuals(self, many: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        name = "effects.stribeck_friction"
        wanted = {f"{name}.extra_force_n[0]": 0.6, f"{name}.extra_force_n[1]": 1.2, f"{name}.velocity_mm_per_s": 1.0}
        return [np.array([1e3 * (values[key] - x) for key, x in wanted.items()]) for values in many]


def test_a_richer_form_begins_at_the_numbers_of_the_simpler_one() -> None:
    def fading(name: str) -> Parameter:
        return Parameter(f"effects.stribeck_friction.{name}", 0.0, 0.5 if "force" in name else 1.0)

    speed = tuple(replace(n, name=n.name.replace("coulomb", "stribeck")) for n in SPEED)
    forces = tuple(fading(f"{name}[{i}]") for name in ("force_n", "extra_force_n") for i in range(2))
    each = Candidate("stribeck_friction", forces, {}, (fading("velocity_mm_per_s"),), finer=speed)
    dry = EACH.shaped
    fitted = Fit(dry.parameters, np.array([2.0, 4.0, 0.7, -0.2]), np.ones(3), np.zeros((3, 4)))
    begun = _started_richer(Nearest(), Hypothesis((dry,), fitted), dry, each.shaped)  # type: ignore[arg-type]
    values = {name.removeprefix("effects.stribeck_friction."): x for name, x in begun.fit.values.items()}
    assert begun.names == ("stribeck_friction",)
    assert [values[key] for key in ("force_n[0]", "force_n[1]")] == [2.0, 4.0]
    assert [values[key] for key in ("creep_mm_per_s", "hold_per_s")] == [0.7, -0.2]
    assert [values[key] for key in ("extra_force_n[0]", "extra_force_n[1]")] == pytest.approx([0.6, 1.2])
    assert values["velocity_mm_per_s"] == 1.0


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
