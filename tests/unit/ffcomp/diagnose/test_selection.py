"""What the search for effects stops at, and what it drops again: on fits that need no simulation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnose import refinement, selection
from ffcomp.diagnose.acceptance import out_of_reach
from ffcomp.diagnose.diagnosis import _ended
from ffcomp.diagnose.exchange import likelier
from ffcomp.diagnose.fit import Fit, values_at
from ffcomp.diagnose.hypotheses import (
    Hypothesis,
    implausible,
    leaves_excess,
    preferring_file,
    significant,
    with_one_within_file,
    within_file,
)
from ffcomp.diagnose.parsimony import predicted_without, simplest
from ffcomp.diagnose.problem import Candidate, Parameter
from ffcomp.diagnose.refinement import within_reach

SHORT, LONG = 200, 20_000


def estimation(*lengths: int) -> SimpleNamespace:
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
    assert implausible(bent) is not within_file(Hypothesis((), bent))


def test_no_effect_is_added_to_itself_with_more_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dry friction beside dry friction that sticks only has more numbers to mimic something else with."""
    friction, sticking, drag = (Candidate(name, (), {}) for name in ("coulomb_friction", "stribeck_friction", "drag"))
    asked: list[str] = []
    monkeypatch.setattr(selection, "screen_roughly", lambda _, __, others: asked.extend(c.name for c in others) or [])
    monkeypatch.setattr(selection, "select_starts", lambda *_, **__: [])
    nothing = fitted(np.zeros(LONG))
    problem = SimpleNamespace(candidates=(friction, sticking, drag))
    search: Any = SimpleNamespace(
        estimation=SimpleNamespace(problem=problem), quick=None, bases=[(nothing, [])], little=0.0, retuned=nothing
    )
    for own in (friction, sticking):
        asked.clear()
        assert selection.add(search, Hypothesis((own,), nothing)) == []
        assert asked == ["drag"]


@pytest.mark.parametrize("bent", [0.5, 4.0])
def test_an_effect_that_bends_the_files_numbers_is_tried_with_a_value_for_each(
    bent: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One change for both belts leaves nothing of the gap, if the number of the axis without any makes up for it."""
    alike, each = Parameter("effects.belt.change", 0.0, 0.3), Parameter("effects.belt.change[1]", 0.0, 0.3)
    other = Candidate("belt", (each,), {})
    belt = Candidate("belt", (alike,), {}, other=other)
    noise = np.ones(LONG)
    own = Parameter("axes.x.frequency_hz[0]", 54.0, 1.0)
    h = Hypothesis((belt,), Fit((own, alike), np.array([bent, -0.7]), noise, np.zeros((LONG, 2))))
    tried: list[Hypothesis] = []

    def fitted_as_well(_: Any, begun: Hypothesis, *__: Any) -> Hypothesis:
        tried.append(begun)
        return Hypothesis(begun.effects, replace(begun.fit, z=np.array([0.0, -0.7])))

    monkeypatch.setattr(refinement, "continue_fit", fitted_as_well)
    problem = estimation(LONG)
    problem.problem = SimpleNamespace(candidates=(belt,), work=SimpleNamespace(allows=lambda: True))
    found = refinement.converge(problem, h, print)  # type: ignore[arg-type]
    assert [one.effects for one in tried][:1] == ([(other,)] if bent > 2 else [])
    assert within_file(found)


@pytest.mark.parametrize("left", [1.0, 2.0])
def test_what_leaves_nothing_but_bends_the_file_is_fitted_exactly_before_more_is_added(
    left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = Parameter("axes.x.frequency_hz[0]", 54.0, 1.0)
    bent = Hypothesis((), Fit((own,), np.array([4.0]), np.full(LONG, left), np.zeros((LONG, 1))))
    straight = Hypothesis((), replace(bent.fit, z=np.array([0.1])))
    monkeypatch.setattr(selection, "refine", lambda *_: straight)
    search: Any = SimpleNamespace(estimation=estimation(LONG), progress=print)
    assert selection.straightened(search, bent) is (straight if left == 1.0 else bent)
    assert selection.straightened(search, straight) is straight


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
    assert likelier(dry, [fading]) is dry
    assert likelier(dry, [ripple]) is ripple  # another effect need only be likelier
    assert likelier(dry, [most]) is most


def test_what_does_much_the_same_as_a_named_effect_is_its_shape_where_only_a_trace_is_left() -> None:
    rng = np.random.default_rng(6)
    slow, other, rest = rng.standard_normal((3, LONG))
    hypotheses = {name: bending(name, 0.0, 0.0) for name in ("guide_damping", "quadratic_drag", "belt_stiffness")}
    signatures = {"guide_damping": slow, "quadratic_drag": slow + 0.3 * rest, "belt_stiffness": other}
    screened = [
        SimpleNamespace(candidate=h.effects[0], signature=signatures[n][:, None], estimate=np.ones(1))
        for n, h in hypotheses.items()
    ]
    search: Any = SimpleNamespace(bases=[(None, screened)])
    best = hypotheses["guide_damping"]
    drag, belt = (
        Hypothesis((*best.effects, *hypotheses[n].effects), best.fit) for n in ("quadratic_drag", "belt_stiffness")
    )
    assert selection._is_shape(search, best, drag) and not selection._is_shape(search, best, belt)


def linear(measured: np.ndarray, columns: dict[str, np.ndarray], start: dict[str, float]) -> Any:
    """A problem whose simulation is linear in its parameters."""

    def residuals(many: Sequence[Mapping[str, float]]) -> Iterator[np.ndarray]:
        for v in many:
            yield measured - sum(columns[n] * (v.get(n, x) - x) for n, x in start.items())

    return SimpleNamespace(residuals=residuals, coarse=False)


def test_numbers_that_make_up_for_each_other_come_back_before_an_effect_is_named_for_it() -> None:
    """Mass and stiffness four uncertainties off leave nothing, as they do at home: no effect is needed."""
    rng = np.random.default_rng(2)
    both = rng.standard_normal(LONG)
    columns = {"mass": 3.0 * both, "belt": -3.0 * both}
    own = tuple(Parameter(n, 0.0, 1.0, -5.0, 5.0) for n in columns)
    problem = linear(rng.standard_normal(LONG), columns, dict.fromkeys(columns, 0.0))
    z = np.array([4.0, 4.0])
    jacobian = np.stack(list(columns.values()), axis=1)
    astray = Fit(own, z, next(problem.residuals([values_at(own, z)])), jacobian)
    assert np.abs(_ended(problem, astray, 0.1).z).max() < 0.1
    loud = replace(astray, residual=astray.residual + 3.0 * rng.standard_normal(LONG))
    assert _ended(problem, loud, 0.1) is loud  # it leaves something that they cannot explain


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
    assert with_one_within_file([guides, frame], [guides, frame, rough, belt]) == [guides, frame, rough]
    assert with_one_within_file([guides, belt], [guides, belt, rough]) == [guides, belt]
    assert with_one_within_file([guides], [guides, frame]) == [guides]
    assert guides.fit.evidence < belt.fit.evidence  # and yet
    assert preferring_file(guides, [guides, frame, belt], 0.05) is belt
    assert preferring_file(guides, [guides, frame, rough], 0.05) is guides  # which leaves too much
    assert preferring_file(belt, [rough, belt], 0.05) is belt


def test_numbers_of_the_file_are_held_within_reach_where_an_effect_explains_as_much() -> None:
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((2, LONG))
    stiffness, delay = Parameter("belt", 1.0, 0.02), Parameter("effects.command_delay.delay_s", 0.0, 1.0)
    measured = rng.standard_normal(LONG) + columns[1] * 5.0 - columns[0] * 0.05  # as if it were 2.5 of its sd off

    def residuals(many: Sequence[Mapping[str, float]]) -> Iterator[np.ndarray]:
        for v in many:
            yield measured - columns[0] * (v[stiffness.name] - 1.0) - columns[1] * v[delay.name]

    problem: Any = SimpleNamespace(residuals=residuals, coarse=False)
    z = np.array([-4.0, 5.0])
    begun = Fit((stiffness, delay), z, next(residuals([values_at((stiffness, delay), z)])), columns.T * [0.02, 1.0])
    best = Hypothesis((Candidate("command_delay", (delay,), {}),), begun)
    held = within_reach(problem, best, lambda _: None)
    assert out_of_reach(best) and not out_of_reach(held)
    assert held.fit.z[0] == pytest.approx(-np.sqrt(3.0)) and held.fit.z[1] == pytest.approx(5.0, abs=0.05)
    assert held.discrepancy < 0.05


def test_a_contender_is_given_up_by_what_coarse_steps_leave_of_both(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of strong friction coarse steps leave a tenth: nothing by which to give up what exact ones explain as well."""

    def leaving(name: str, discrepancy: float) -> Hypothesis:
        return Hypothesis((Candidate(name, (), {}),), fitted(np.full(LONG, np.sqrt(1.0 + discrepancy))))

    asked: list[str] = []

    def exactly(_: Any, h: Hypothesis, *__: Any) -> Hypothesis:
        asked.extend(h.names)
        return leaving(h.names[0], 0.0)

    monkeypatch.setattr(selection, "continue_fit", exactly)
    monkeypatch.setattr(selection, "begun_anew", lambda _, h, *__: h)
    search = SimpleNamespace(estimation=None, progress=None, little=0.0, may_go_on=lambda: True)
    contenders = [leaving("stribeck", 50.0), leaving("coulomb", 55.0), leaving("cogging", 900.0)]
    found = selection.fitted_well(search, contenders)  # type: ignore[arg-type]
    assert asked == ["stribeck", "coulomb"] and found[2] is contenders[2]
    assert [h.discrepancy for h in found[:2]] == pytest.approx([0.0, 0.0])


def test_a_contender_of_fewer_numbers_is_not_given_up_for_one_of_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """One soft belt leaves twenty times as much as belts by position in a quick fit, and as little in a good one."""

    def leaving(name: str, discrepancy: float, numbers: int) -> Hypothesis:
        own = tuple(Parameter(f"effects.{name}.n{i}", 0.0, 1.0) for i in range(numbers))
        residual = np.full(LONG, np.sqrt(1.0 + discrepancy))
        return Hypothesis((Candidate(name, own, {}),), Fit(own, np.zeros(numbers), residual, np.zeros((LONG, numbers))))

    asked: list[str] = []
    monkeypatch.setattr(selection, "continue_fit", lambda _, h, __: asked.extend(h.names) or h)
    monkeypatch.setattr(selection, "begun_anew", lambda _, h, *__: h)
    search = SimpleNamespace(estimation=None, progress=None, little=0.0, may_go_on=lambda: True)
    by_position = leaving("belt_position_stiffness", 0.0, 3)
    for numbers, expected in ((2, ["belt_position_stiffness", "belt"]), (4, ["belt_position_stiffness"])):
        asked.clear()
        selection.fitted_well(search, [by_position, leaving("belt", 0.95, numbers)])  # type: ignore[arg-type]
        assert asked == expected


def test_a_usual_shape_that_bends_the_numbers_beside_it_is_set_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sine without the belt's share fits nearly as well with a wrong amplitude: its interval would lie."""
    monkeypatch.setattr(refinement, "_placed", lambda _, begun, __: (begun, 0.0))
    rng = np.random.default_rng(5)
    size, share = Parameter("effects.sine.size", 0.0, 10.0), Parameter("effects.sine.share", 0.0, 1.0)
    along, across = rng.standard_normal((2, LONG))
    columns = {size.name: along, share.name: 0.2 * along + 0.05 * across}
    sine = Candidate("sine", (size,), {}, finer=(share,))

    def explained(shared: float) -> Hypothesis:
        measured = rng.standard_normal(LONG) + 3.0 * along + shared * columns[share.name]
        problem = linear(measured, columns, {size.name: 0.0, share.name: 0.0})
        problem.residual = lambda values: next(problem.residuals([values]))
        problem.problem = SimpleNamespace(work=SimpleNamespace(allows=lambda: True))
        alone = 10.0 * along[:, None]
        z = np.linalg.lstsq(alone, measured, rcond=None)[0]
        held = Hypothesis((sine,), Fit((size,), z, measured - alone @ z, alone))
        return refinement.with_free_shapes(problem, held, lambda _: None)

    freed = explained(2.0)
    assert freed.fit.values[size.name] == pytest.approx(3.0, abs=0.1)
    assert freed.fit.values[share.name] == pytest.approx(2.0, abs=0.4)
    assert explained(0.0).effects == (sine,)  # nothing asks for it


def test_what_no_two_motions_agree_on_is_dropped_where_the_rest_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ripple of a ten-thousandth of a millimetre is the error of another effect's shape, however significant."""
    rng = np.random.default_rng(6)
    belt, ripple = (Parameter(f"effects.{name}.size", 0.0, 1.0) for name in ("belt", "ripple"))
    columns = rng.standard_normal((LONG, 2)) * [30.0, 0.05]
    candidates = tuple(Candidate(n.name.split(".")[1], (n,), {}) for n in (belt, ripple))

    def hypothesis(ripples: float) -> Hypothesis:
        return Hypothesis(candidates, Fit((belt, ripple), np.array([5.0, ripples]), rng.standard_normal(LONG), columns))

    def told(_: Any, fit: Fit, __: Any, scatter: bool) -> dict[str, Any]:
        spread = {belt.name: 0.1, ripple.name: 20.0 if scatter else 0.1}
        return {
            n.name: SimpleNamespace(low=z - spread[n.name], high=z + spread[n.name])
            for n, z in zip(fit.parameters, fit.z, strict=True)
        }

    def without(_: Any, h: Hypothesis, dropped: Candidate, __: Any) -> Hypothesis:
        return Hypothesis(tuple(c for c in h.effects if c is not dropped), predicted_without(h, dropped))

    monkeypatch.setattr(selection, "intervals_of", told)
    monkeypatch.setattr(selection, "drop", without)
    monkeypatch.setattr(selection, "refine_best", lambda _, so_far: so_far)
    search = SimpleNamespace(
        estimation=SimpleNamespace(tolerance=0.05), retuned=fitted(np.full(LONG, 3.0)), progress=lambda _: None
    )
    best = hypothesis(4.0)
    assert significant(best.fit, predicted_without(best, candidates[1]))
    dropped = selection.drop_superfluous(search, selection.Selection(best, ()))  # type: ignore[arg-type]
    assert dropped.best.names == ("belt",)
    strong = hypothesis(12.0)  # without it, something is left
    kept = selection.drop_superfluous(search, selection.Selection(strong, ()))  # type: ignore[arg-type]
    assert kept.best.names == ("belt", "ripple")


@dataclass(frozen=True)
class Swinging:
    """Motions that answer a number by sines of it, each louder one by a faster one."""

    truth: float
    chosen: tuple[int, ...] = (0, 1, 2, 3, 4)
    coarse: bool = False

    @property
    def problem(self) -> Any:
        return SimpleNamespace(motions=range(5), work=SimpleNamespace(allows=lambda: True))

    @property
    def whiten(self) -> Any:
        return SimpleNamespace(rows=[slice(100 * k, 100 * (k + 1)) for k in range(len(self.chosen))])

    def limited_to(self, chosen: Sequence[int]) -> Swinging:
        return replace(self, chosen=tuple(chosen))

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        loud = 2.0 ** np.repeat(self.chosen, 100)
        turns = loud * np.tile(np.linspace(0.5, 1.0, 100), len(self.chosen))
        return 100.0 * loud * (np.sin(turns * self.truth) - np.sin(turns * values["effects.cubic.size"]))

    def residuals(self, many: Sequence[Mapping[str, float]]) -> Iterator[np.ndarray]:
        return map(self.residual, many)


def test_a_number_that_loud_motions_hide_is_found_from_the_quiet_ones() -> None:
    problem: Any = Swinging(1.2)
    size = Parameter("effects.cubic.size", 0.0, 1.0)
    residual = problem.residual({size.name: 0.1})
    begun = Fit((size,), np.array([0.1]), residual, np.zeros((len(residual), 1)))
    astray = refinement.continue_fit(problem, Hypothesis((Candidate("cubic", (size,), {}),), begun), lambda _: None)
    assert abs(astray.fit.values[size.name] - 1.2) > 0.1
    found = refinement.by_degrees(problem, astray, lambda _: None)
    assert found.fit.values[size.name] == pytest.approx(1.2, abs=1e-3)
