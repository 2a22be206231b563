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
    prefer_plausible,
    significant,
    simplest,
    with_a_plausible,
)
from ffcomp.diagnosis.problem import Candidate, Parameter
from ffcomp.diagnosis.search import accepted

SHORT, LONG = 200, 20_000


def estimation(*lengths: int) -> Any:
    """A problem of observations of so many rows."""
    ends = np.cumsum(lengths)
    rows = [slice(b - n, b) for b, n in zip(ends, lengths, strict=True)]
    return SimpleNamespace(tolerance=0.1, whiten=SimpleNamespace(rows=rows))


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
    assert not significant(best.fit, predicted_without(best, belt_only))
    assert significant(best.fit, predicted_without(best, shape_only))


def test_a_freer_shape_is_no_reason_to_name_another_effect() -> None:
    """A sine with its belt's share freed fits a little better than a softening belt: both need one number."""

    def needing(name: str, *shapes: str) -> Candidate:
        own = tuple(Parameter(f"effects.{name}.{each}", 0.0, 1.0) for each in ("size", *shapes))
        return Candidate(name, own[:1], {}, own[1:])

    def explained(candidate: Candidate, left: float, finer: int = 0) -> Hypothesis:
        count = len(candidate.parameters) + finer
        parameters = tuple(Parameter(f"{candidate.name} {i}", 0.0, 1.0) for i in range(count))
        residual = np.full(LONG, np.sqrt(1 + left))
        return Hypothesis((candidate,), Fit(parameters, np.zeros(count), residual, np.zeros((LONG, count))))

    candidates = [needing("belt"), needing("sine"), needing("stribeck", "extra", "speed")]
    belt, sine, stribeck = (explained(c, *a) for c, a in zip(candidates, [(0.121,), (0.118, 1), (0.118,)], strict=True))
    assert simplest(sine, [belt, sine], candidates) is sine
    assert simplest(stribeck, [belt, stribeck], candidates) is belt  # it needs more, and explains hardly more


def test_more_numbers_of_the_same_effect_are_no_exchange_unless_they_take_a_good_share() -> None:
    """On a measured stage (EMPS) friction that fades with speed took a twentieth more than dry friction."""

    def beside_drag(name: str, left: float) -> Hypothesis:
        effects = tuple(Candidate(n, (Parameter(f"{n} size", 0.0, 1.0),), {}) for n in ("drag", name))
        parameters = tuple(n for c in effects for n in c.parameters)
        residual = np.full(LONG, np.sqrt(1 + left))
        return Hypothesis(effects, Fit(parameters, np.zeros(2), residual, np.zeros((LONG, 2))))

    dry, most = beside_drag("coulomb_friction", 1.0), beside_drag("stribeck_friction", 0.1)
    fading, ripple = (beside_drag(name, 0.95) for name in ("stribeck_friction", "cogging_force"))
    assert accepted(dry, [fading]) is dry
    assert accepted(dry, [ripple]) is ripple  # another effect need only be likelier
    assert accepted(dry, [most]) is most


def bending(name: str, file_z: float, left: float, clock_z: float = 0.0) -> Hypothesis:
    """An effect of the size 1, with a number of the file and a recording's clock so many uncertainties off."""
    own = Parameter("axes.y.frequency_hz[0]", 29.0, 0.6), Parameter("recording.loop.delay_s", 0.0, 1e-4)
    effect = Parameter(f"effects.{name}.size", 0.0, 1.0)
    residual = np.full(LONG, np.sqrt(1 + left))
    z = np.array([file_z, clock_z, 1.0])
    return Hypothesis((Candidate(name, (effect,), {}),), Fit((*own, effect), z, residual, np.zeros((LONG, 3))))


def test_an_effect_that_is_a_number_of_the_file_does_not_lose_to_bending_it() -> None:
    """A softer belt, fitted roughly, beside guides that damp more and a frequency five uncertainties too low."""
    guides, frame = bending("guide_damping", 5.0, 0.0), bending("frame_mode", 4.0, 0.01)
    rough, belt = bending("belt_stiffness", 1.0, 1.7), bending("belt_stiffness", 1.0, 0.01, clock_z=5.0)
    assert with_a_plausible([guides, frame], [guides, frame, rough, belt]) == [guides, frame, rough]
    assert with_a_plausible([guides, belt], [guides, belt, rough]) == [guides, belt]
    assert with_a_plausible([guides], [guides, frame]) == [guides]
    assert guides.fit.evidence < belt.fit.evidence  # and yet
    assert prefer_plausible(guides, [guides, frame, belt], 0.05) is belt
    assert prefer_plausible(guides, [guides, frame, rough], 0.05) is guides  # which leaves too much
    assert prefer_plausible(belt, [rough, belt], 0.05) is belt


def leaving(name: str, left: float) -> Hypothesis:
    """A hypothesis that leaves so much of the noise beside it."""
    residual = np.full(LONG, np.sqrt(1 + left))
    return Hypothesis((Candidate(name, (), {}),), Fit((), np.zeros(0), residual, np.zeros((LONG, 0))))


def test_a_trace_of_a_loud_gap_rules_nothing_out() -> None:
    """Of a gap 770 times the noise a sine leaves 0.14, a softening belt 0.03: either may be it."""
    best, sine, far = leaving("belt_hardening", 0.03), leaving("torque_angle", 0.14), leaving("cogging", 40.0)
    tried = [best, sine, far]
    assert competing_with(best, tried) == []
    assert competing_with(best, tried, gap=770.0) == [sine]
    assert competing_with(best, tried, gap=20.0) == []  # there it is seven thousandths
