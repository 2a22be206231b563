"""Refinement: the forms in which an effect is fitted, one of a kind after the other."""

from __future__ import annotations

from dataclasses import replace

from ffcomp.diagnose.problem import Candidate, Parameter
from ffcomp.diagnose.refinement import BENT, OWN_SHAPE, SHAPE_CHANGES, UNBENT


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
