"""How hypotheses are compared, on fits that need no simulation."""

from __future__ import annotations

import numpy as np

from ffcomp.diagnosis.fidelity import predicted_without
from ffcomp.diagnosis.fit import Fit
from ffcomp.diagnosis.hypotheses import (
    Hypothesis,
    significant,
)
from ffcomp.diagnosis.problem import Candidate, Parameter
from ffcomp.diagnosis.settings import SETTINGS

SHORT, LONG = 200, 20_000


def test_an_effect_that_says_what_a_number_of_the_file_may_say_is_not_needed() -> None:
    """A stiffness that is one and a half of its uncertainties off is retuning; another shape is not."""
    rng = np.random.default_rng(0)
    stiff, other = rng.standard_normal((2, LONG)) * 0.1
    own = Parameter("stiffness", 1.0, 0.05)
    belt, shape = (Parameter(f"effects.{name}", 0.0, 0.2) for name in ("belt", "shape"))
    columns = np.stack([stiff, 4.0 * stiff, other], axis=1)
    z = np.array([0.1, 0.35, 20.0])
    best = Hypothesis(
        (Candidate("belt", (belt,), {}), Candidate("shape", (shape,), {})),
        Fit((own, belt, shape), z, rng.standard_normal(LONG), columns),
    )
    belt_only, shape_only = best.effects
    assert not significant(best.fit, predicted_without(best, belt_only), SETTINGS)
    assert significant(best.fit, predicted_without(best, shape_only), SETTINGS)
