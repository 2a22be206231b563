"""How hypotheses are compared, on fits that need no simulation."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from ffcomp.diagnosis.fidelity import predicted_without
from ffcomp.diagnosis.fit import Fit
from ffcomp.diagnosis.hypotheses import (
    Hypothesis,
    competing_with,
    implausible,
    leaves_excess,
    significant,
)
from ffcomp.diagnosis.problem import Candidate, Parameter
from ffcomp.diagnosis.settings import SETTINGS

SHORT, LONG = 200, 20_000


def estimation(*lengths: int) -> Any:
    """A problem of observations of so many rows."""
    ends = np.cumsum(lengths)
    rows = [slice(b - n, b) for b, n in zip(ends, lengths, strict=True)]
    return SimpleNamespace(tolerance=0.1, settings=SETTINGS, whiten=SimpleNamespace(rows=rows))


def fitted(residual: np.ndarray) -> Fit:
    return Fit((), np.zeros(0), residual, np.zeros((len(residual), 0)))


def test_clocks_that_keep_time_do_not_hide_numbers_that_do_not() -> None:
    """Four and a half uncertainties in one number and five in another are not made likely by eighteen clocks."""
    own = [Parameter("axes.y.frequency_hz[0]", 29.0, 0.6), Parameter("axes.y.damping_ratio[0]", 0.05, 0.001)]
    clocks = [Parameter(f"recording.r{n}.delay_s", 0.0, 3e-4) for n in range(18)]
    z = np.array([-4.3, 5.0, *np.zeros(18)])
    bent = Fit((*own, *clocks), z, np.zeros(1), np.zeros((1, 20)))
    assert implausible(bent)
    assert not implausible(replace(bent, z=np.array([-1.3, 1.5, *np.full(18, 2.0)])))
    assert implausible(bent) is not Hypothesis((), bent).plausible


def test_a_short_window_stands_out_by_chance() -> None:
    """Of 200 rows of noise the mean square is off by 0.1; among a hundred windows one is by three times that."""
    short = np.concatenate([np.ones(LONG), np.full(SHORT, np.sqrt(1.3))])
    assert not leaves_excess(estimation(LONG, SHORT), fitted(short))
    assert leaves_excess(estimation(LONG, SHORT), fitted(np.concatenate([np.ones(LONG), np.full(SHORT, 1.3)])))
    long = np.concatenate([np.full(LONG, np.sqrt(1.15)), np.ones(SHORT)])
    assert leaves_excess(estimation(LONG, SHORT), fitted(long))
    everywhere = np.full(100 * SHORT, np.sqrt(1.15))  # too little for any one of them, but it is in all
    assert leaves_excess(estimation(*[SHORT] * 100), fitted(everywhere))


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


def leaving(name: str, left: float) -> Hypothesis:
    """A hypothesis that leaves so much of the noise beside it."""
    residual = np.full(LONG, np.sqrt(1 + left))
    return Hypothesis((Candidate(name, (), {}),), Fit((), np.zeros(0), residual, np.zeros((LONG, 0))))


def test_a_trace_of_a_loud_gap_rules_nothing_out() -> None:
    """Of a gap 770 times the noise a sine leaves 0.14, a softening belt 0.03: either may be it."""
    best, sine, far = leaving("belt_hardening", 0.03), leaving("torque_angle", 0.14), leaving("cogging", 40.0)
    tried = [best, sine, far]
    assert competing_with(best, tried, SETTINGS) == []
    assert competing_with(best, tried, SETTINGS, gap=770.0) == [sine]
    assert competing_with(best, tried, SETTINGS, gap=20.0) == []  # there it is seven thousandths
