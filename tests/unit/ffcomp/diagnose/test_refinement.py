"""Refinement: the forms in which an effect is fitted, one of a kind after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from ffcomp.diagnose import refinement
from ffcomp.diagnose.fit import Fit
from ffcomp.diagnose.hypotheses import Hypothesis
from ffcomp.diagnose.problem import Candidate, Parameter
from ffcomp.diagnose.refinement import BENT, OWN_SHAPE, SHAPE_CHANGES, UNBENT, enriched


def number(name: str) -> Parameter:
    return Parameter(f"effects.coulomb_friction.{name}", 0.0, 1.0)


SPEED = (number("creep_mm_per_s"), number("hold_per_s"))
EACH = Candidate(
    "coulomb_friction",
    tuple(number(f"force_n[{i}]") for i in range(2)),
    {},
    finer=SPEED,
    bent=tuple(number(f"presliding_mm[{i}]") for i in range(2)),
)
FRICTION = Candidate(
    "coulomb_friction", (number("force_n"),), {}, finer=SPEED, bent=(number("presliding_mm"),), other=EACH
)
OTHER, FIRST = (change.change for change in SHAPE_CHANGES)


def test_friction_bends_instead_of_creeping_and_the_other_way_round() -> None:
    for first in (FRICTION, EACH):
        bent = BENT.change(OWN_SHAPE.change(first, FRICTION), FRICTION)
        assert bent.shapes == first.bent and not bent.finer and bent.amplitudes == first.amplitudes
        assert BENT.change(bent, FRICTION) is bent and OWN_SHAPE.change(bent, FRICTION) is bent
        assert UNBENT.change(bent, FRICTION).shapes == SPEED


def test_another_number_of_forces_is_of_the_same_kind() -> None:
    bent = BENT.change(FRICTION, FRICTION)
    each = OTHER(bent, FRICTION)
    assert each.amplitudes == EACH.amplitudes and each.shapes == EACH.bent
    assert FIRST(each, FRICTION).parameters == bent.parameters
    creeping = OTHER(OWN_SHAPE.change(FRICTION, FRICTION), FRICTION)
    assert creeping.shapes == SPEED and FIRST(creeping, FRICTION).shapes == SPEED


def test_an_effect_of_one_kind_has_no_other() -> None:
    plain = replace(FRICTION, bent=(), other=replace(EACH, bent=()))
    assert BENT.change(plain, plain) is plain and UNBENT.change(plain, plain) is plain
    assert OTHER(plain, plain).amplitudes == EACH.amplitudes


@dataclass(frozen=True)
class Nearest:
    """A problem whose error is how far the new numbers of fading friction are from 0.3 of the old ones, and 1."""

    problem: SimpleNamespace
    coarse: bool = False

    def residuals(self, many: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        name = "effects.stribeck_friction"
        wanted = {f"{name}.extra_force_n[0]": 0.6, f"{name}.extra_force_n[1]": 1.2, f"{name}.velocity_mm_per_s": 1.0}
        return [np.array([1e3 * (values[key] - x) for key, x in wanted.items()]) for values in many]


def test_a_richer_form_begins_at_the_numbers_of_the_simpler_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def fading(name: str) -> Parameter:
        return Parameter(f"effects.stribeck_friction.{name}", 0.0, 0.5 if "force" in name else 1.0)

    speed = tuple(replace(n, name=n.name.replace("coulomb", "stribeck")) for n in SPEED)
    forces = tuple(fading(f"{name}[{i}]") for name in ("force_n", "extra_force_n") for i in range(2))
    each = Candidate("stribeck_friction", forces, {}, (fading("velocity_mm_per_s"),), finer=speed)
    richer = Candidate("stribeck_friction", (fading("force_n"), fading("extra_force_n")), {}, each.shapes, other=each)
    monkeypatch.setattr(refinement, "continue_fit", lambda _, h, __: h)
    monkeypatch.setattr(refinement, "converge", lambda _, h, __: h)
    work = SimpleNamespace(allows=lambda: True)
    problem = SimpleNamespace(candidates=[FRICTION, richer], work=work)
    dry = EACH.shaped
    fitted = Fit(dry.parameters, np.array([2.0, 4.0, 0.7, -0.2]), np.ones(3), np.zeros((3, 4)))
    (found,) = enriched(Nearest(problem), Hypothesis((dry,), fitted), print)  # type: ignore[arg-type]
    values = {name.removeprefix("effects.stribeck_friction."): x for name, x in found.fit.values.items()}
    assert found.names == ("stribeck_friction",)
    assert [values[key] for key in ("force_n[0]", "force_n[1]")] == [2.0, 4.0]
    assert [values[key] for key in ("creep_mm_per_s", "hold_per_s")] == [0.7, -0.2]
    assert [values[key] for key in ("extra_force_n[0]", "extra_force_n[1]")] == pytest.approx([0.6, 1.2])
    assert values["velocity_mm_per_s"] == 1.0
    plain = Hypothesis((Candidate("cogging", (), {}),), Fit((), np.zeros(0), np.ones(3), np.zeros((3, 0))))
    problem.candidates.append(plain.effects[0])
    assert enriched(Nearest(problem), plain, print) == []  # type: ignore[arg-type]
