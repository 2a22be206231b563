"""What keeps effects from being named."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.acceptance import rejections
from ffcomp.diagnosis.fit import Fit
from ffcomp.diagnosis.held_out import HeldOut
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.problem import Candidate, Parameter
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.identification.uncertainty import Estimate

OWN = (Parameter("carriage.mass_kg", 0.2, 0.004), Parameter("recording.zigzag-0.delay_s", 0.0, 3e-4))
ESTIMATION: Any = SimpleNamespace(settings=SETTINGS, tolerance=0.05)
EFFECT = Parameter("effects.effector_mass.added_kg", 0.0, 0.1)


def named(z: tuple[float, float]) -> Hypothesis:
    """Return a hypothesis of one effect, with the file's number and a clock moved so far."""
    fitted = Fit((*OWN, EFFECT), np.array([*z, 1.2]), np.ones(1000), np.zeros((1000, 3)))
    return Hypothesis((Candidate("effector_mass", (EFFECT,), {EFFECT.name: 0.1}),), fitted)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("belt_stiffness", "guide_damping", "extruder_mount"), True),
        (("belt_stiffness", "guide_damping"), False),
        (("belt_stiffness", "guide_damping", "coulomb_friction"), False),
    ],
)
def test_where_three_of_the_files_numbers_are_far_off_it_is_of_another_machine(
    names: tuple[str, ...], said: bool
) -> None:
    base = Fit(OWN, np.zeros(2), np.full(1000, 10.0), np.zeros((1000, 2)))
    sizes = tuple(Parameter(f"effects.{name}.size", 0.0, 0.1) for name in names)
    fitted = Fit((*OWN, *sizes), np.zeros(2 + len(names)), np.ones(1000), np.zeros((1000, 2 + len(names))))
    effects = tuple(Candidate(name, (own,), {own.name: 0.1}) for name, own in zip(names, sizes, strict=True))
    held_out = [HeldOut(place, "", rows=500, before=99.0, after=0.0) for place in ((0.0, 0.0), (55.0, 20.0))]
    intervals = {own.name: Estimate(0.12, 0.01, 0.1, 0.14) for own in sizes}
    found = rejections(ESTIMATION, base, Hypothesis(effects, fitted), held_out, intervals)
    assert any("the file of another machine" in text for text in found) == said
