"""Which hypotheses stand beside the best: as likely, or as good as any shape can be."""

from __future__ import annotations

import numpy as np

from ffcomp.diagnose.confounding import competing_with
from ffcomp.diagnose.fit import Fit
from ffcomp.diagnose.hypotheses import Hypothesis
from ffcomp.diagnose.problem import Candidate

ROWS = 10_000


def explained(name: str, left: float) -> Hypothesis:
    """A hypothesis that leaves so much of the noise beside it."""
    residual = np.full(ROWS, np.sqrt(1 + left))
    return Hypothesis((Candidate(name, (), {}),), Fit((), np.zeros(0), residual, np.zeros((ROWS, 0))))


def test_a_trace_of_a_loud_gap_rules_nothing_out() -> None:
    """Of a gap 770 times the noise a sine leaves 0.14, a softening belt 0.03: either may be it."""
    best, sine, far = explained("belt_hardening", 0.03), explained("torque_angle", 0.14), explained("cogging", 40.0)
    tried = [best, sine, far]
    assert competing_with(best, tried) == []
    assert competing_with(best, tried, gap=770.0) == [sine]
    assert competing_with(best, tried, gap=20.0) == []  # there it is seven thousandths
