"""The ladder of fidelity: fits that are held, restarted, continued from quiet motions, or begun on a short horizon."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.acceptance import out_of_reach
from ffcomp.diagnosis.diagnosis import _fitted_to_the_end, _needed
from ffcomp.diagnosis.fidelity import (
    _rescaled,
    by_continuation,
    continue_fit,
    fit_within_uncertainty,
    from_short_horizon,
)
from ffcomp.diagnosis.fit import EstimationProblem, Fit, derivatives, estimation_problem, fit, values_at
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.moves import free_shapes
from ffcomp.diagnosis.noise import NoiseFloor, noise_floor, whitener
from ffcomp.diagnosis.problem import Candidate, Parameter
from ffcomp.diagnosis.problems import problem_of, recordings_of
from ffcomp.diagnosis.score_test import screen
from ffcomp.diagnosis.search import Selection, _likelier_at_the_end, _swapped
from models.file import load_plant
from validation.blind.cases import case

LONG = 20_000
NAMES = ("belt_backlash", "coulomb_friction", "belt_stiffness")
WIDTH = "effects.belt_backlash.width_mm"


def test_numbers_that_make_up_for_each_other_come_back_before_an_effect_is_named_for_it() -> None:
    """Mass and stiffness four uncertainties off leave nothing, as they do at home: no effect is needed."""
    rng = np.random.default_rng(2)
    both = rng.standard_normal(LONG)
    columns = {"mass": 3.0 * both, "belt": -3.0 * both}
    own = tuple(Parameter(n, 0.0, 1.0, -5.0, 5.0) for n in columns)
    problem: Any = Linear(rng.standard_normal(LONG), columns)
    z = np.array([4.0, 4.0])
    jacobian = np.stack(list(columns.values()), axis=1)
    astray = Fit(own, z, next(problem.residuals([values_at(own, z)])), jacobian)
    assert np.abs(_fitted_to_the_end(problem, astray, 0.1).z).max() < 0.1
    loud = replace(astray, residual=astray.residual + 3.0 * rng.standard_normal(LONG))
    assert _fitted_to_the_end(problem, loud, 0.1) is loud  # it leaves something that they cannot explain


def test_all_masses_and_forces_come_back_by_one_factor_where_motion_tells_only_their_ratios() -> None:
    """Mass, stiffness and friction are a fifth too small together: ratios that fit; the file tells the factor."""
    mass, stiffness = Parameter("axis.mass_kg", 5.0, 0.25), Parameter("axis.stiffness_n_per_m", 1e5, 5e3)
    force, speed = Parameter("effects.coulomb_friction.force_n", 0.0, 4.0), Parameter("effects.x.shape_mm", 0.0, 1.0)
    friction = Candidate("coulomb_friction", (force, speed), {})
    own = (mass, stiffness, force, speed)
    noise = np.random.default_rng(4).standard_normal(LONG)

    def residual(v: Mapping[str, float]) -> np.ndarray:
        ratios = v[stiffness.name] / v[mass.name] - 2e4, v[force.name] / v[mass.name] - 2.0, v[speed.name] - 3.0
        return noise + 30.0 * sum(ratios)

    z = np.array([-4.0, -4.0, 2.0, 3.0])
    astray = Hypothesis((friction,), Fit(own, z, residual(values_at(own, z)), np.ones((LONG, 4))))
    problem: Any = SimpleNamespace(residual=residual)
    back = _rescaled(problem, astray)
    assert not astray.plausible
    assert back.fit.z == pytest.approx([0.0, 0.0, 2.5, 3.0])
    measured: Any = SimpleNamespace(residual=lambda v: noise + (v[force.name] - 8.0))  # a force is measured as well
    assert _rescaled(measured, replace(astray, fit=replace(astray.fit, residual=noise))).fit.z == pytest.approx(z)


def test_numbers_of_the_file_are_held_within_reach_where_an_effect_explains_as_much() -> None:
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((2, LONG))
    stiffness, delay = Parameter("belt", 1.0, 0.02), Parameter("effects.command_delay.delay_s", 0.0, 1.0)
    measured = rng.standard_normal(LONG) + columns[1] * 5.0 - columns[0] * 0.05  # as if it were 2.5 of its sd off

    def residuals(many: Sequence[Mapping[str, float]]) -> Iterator[np.ndarray]:
        for v in many:
            yield measured - columns[0] * (v[stiffness.name] - 1.0) - columns[1] * v[delay.name]

    problem: Any = SimpleNamespace(residuals=residuals, residual=lambda v: next(residuals([v])), coarse=True)
    z = np.array([-4.0, 5.0])
    begun = Fit((stiffness, delay), z, next(residuals([values_at((stiffness, delay), z)])), columns.T * [0.02, 1.0])
    best = Hypothesis((Candidate("command_delay", (delay,), {}),), begun)
    held = fit_within_uncertainty(problem, best, lambda _: None)
    assert out_of_reach(best) and not out_of_reach(held)
    assert held.fit.z[0] == pytest.approx(-np.sqrt(3.0)) and held.fit.z[1] == pytest.approx(5.0, abs=0.05)
    assert held.discrepancy < 0.05


@dataclass(frozen=True)
class Swinging:
    """Motions that answer a number by sines of it, each louder one by a faster one."""

    truth: float
    chosen: tuple[int, ...] = (0, 1, 2, 3, 4)
    coarse: bool = False

    @property
    def problem(self) -> Any:
        return SimpleNamespace(motions=range(5))

    @property
    def whiten(self) -> Any:
        return SimpleNamespace(rows=[slice(100 * k, 100 * (k + 1)) for k in range(len(self.chosen))])

    @property
    def may_go_on(self) -> bool:
        return True

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
    astray = continue_fit(problem, Hypothesis((Candidate("cubic", (size,), {}),), begun), lambda _: None)
    assert abs(astray.fit.values[size.name] - 1.2) > 0.1
    found = by_continuation(problem, astray, lambda _: None)
    assert found.fit.values[size.name] == pytest.approx(1.2, abs=1e-3)


def test_quiet_motions_that_are_explained_no_better_by_themselves_lead_nowhere() -> None:
    problem: Any = Swinging(1.2)
    size, said = Parameter("effects.cubic.size", 0.0, 1.0, 1.3, 2.0), list[str]()  # the truth is out of reach
    held = Hypothesis((Candidate("cubic", (size,), {}),), fit(problem, (size,), np.array([1.3])))
    assert by_continuation(problem, held, said.append) is held
    assert sum("in 2 quiet motions:" in each for each in said) == 1 and not any("in 4" in each for each in said)


# ---- a short horizon -----------------------------------------------------------------------------


@cache
def printer(names: str, seed: int, folder: Path) -> tuple[EstimationProblem, dict[str, dict[str, object]]]:
    """A CoreXY of the bank, whose plant has soft flanks, landings, and a mount that the file does not tell of."""
    made = case(seed, f"corexy/single/usual:{names}", 1.5, short=True)
    (folder / "machine.toml").write_text(made.machine)
    for name, text in made.runs.items():
        (folder / name).write_text(text)
    machine = load_plant(folder / "machine.toml")
    problem = problem_of(machine, recordings_of(machine, sorted(folder.glob("*.csv")), None), NAMES)
    found = estimation_problem(problem, whitener(problem.observations, noise_floor(problem), problem.band_hz))
    return found, dict(made.label.effects)


def retuned(estimation: EstimationProblem) -> Fit:
    own = tuple(estimation.problem.parameters)
    columns = derivatives(estimation, own, np.zeros(len(own)), estimation.residual({}), range(len(own)))
    return fit(estimation, own, np.zeros(len(own)), columns)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("printer")


def test_wide_play_is_found_with_its_widths(folder: Path) -> None:
    estimation, hidden = printer("belt_backlash", 81234303, folder)
    base = retuned(estimation)
    assert base.discrepancy > 100.0  # times the noise, and so much in the dark
    screened = screen(estimation, base, estimation.problem.candidates)
    found = from_short_horizon(estimation, screened, Hypothesis((), base), lambda said: None)
    assert found is not None and found.names == ("belt_backlash",) and found.plausible
    assert found.discrepancy < 0.02 * base.discrepancy
    widths = [found.fit.values[f"{WIDTH}[{i}]"] for i in range(2)]
    assert widths == pytest.approx(hidden["belt_backlash"]["width_mm"][:2], rel=0.03)  # type: ignore[index]


def test_where_nothing_explains_the_beginnings_nothing_is_followed(folder: Path) -> None:
    estimation, _ = printer("belt_backlash", 81234303, folder)
    base = retuned(estimation)
    others = [c for c in estimation.problem.candidates if c.name == "belt_stiffness"]
    screened, nothing = screen(estimation, base, others), Hypothesis((), base)
    assert from_short_horizon(estimation, screened, nothing, lambda said: None) is None


# ---- shapes set free -----------------------------------------------------------------------------


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


def test_of_two_that_explain_the_same_the_likelier_at_the_end_is_named() -> None:
    """A gain 8 % too small is a sensor turned by 22 degrees as well; its fit was not yet at its end."""
    rng = np.random.default_rng(6)
    gain, turn = Parameter("effects.gain.change", 0.0, 0.1), Parameter("effects.turn.angle", 0.0, 5.0)
    true = 20.0 * rng.standard_normal(LONG)
    problem: Any = Linear(rng.standard_normal(LONG) - 0.08 * true, {gain.name: true, turn.name: -0.08 / 22 * true})

    def hypothesis(n: Parameter, value: float) -> Hypothesis:
        z = np.array([value / n.sd])
        fitted = Fit((n,), z, problem.residual({n.name: value}), n.sd * problem.columns[n.name][:, None])
        return Hypothesis((Candidate(n.name.split(".")[1], (n,), {}),), fitted)

    turned, scaled = hypothesis(turn, 22.0), hypothesis(gain, -0.0787)
    search: Any = SimpleNamespace(estimation=problem, progress=lambda _: None)
    assert 0.0 < scaled.fit.evidence - turned.fit.evidence < 20.0
    found = _likelier_at_the_end(search, turned, Selection(turned, (turned, scaled)))
    assert found.names == ("gain",) and found.fit.values[gain.name] == pytest.approx(-0.08, abs=0.001)
    assert _likelier_at_the_end(search, turned, Selection(turned, (turned,))) is turned


def test_of_two_laws_the_smaller_one_takes_the_place_of_the_other_where_it_is_likelier(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A weight with an angle, and a spring that leaves less: it was tried and passed over, for both need one number."""

    def one(name: str, left: float) -> Hypothesis:
        n = Parameter(f"effects.{name}.size", 0.0, 1.0)
        return Hypothesis((Candidate(name, (n,), {}),), Fit((n,), np.ones(1), np.full(900, left), np.ones((900, 1))))

    weight, spring, worse = one("weight", 1.7), one("spring", 1.2), one("other", 2.0)
    monkeypatch.setattr("ffcomp.diagnosis.search.swap_for_alike", lambda *_: [worse, spring])
    search: Any = None
    assert _swapped(search, weight, (weight,)) == (spring, (weight, worse, spring))
    assert _swapped(search, spring, ())[0] is spring


def test_numbers_far_beyond_what_the_file_says_are_no_better_file() -> None:
    """By a noise that is guessed an effect must leave 5 % less; but not if the file would be off by 4.9 of its sd."""
    number, size = Parameter("axis.stiffness", 1.0, 0.02), Parameter("effects.belt.change", 0.0, 0.1)
    belt, rows = Candidate("belt", (size,), {}), np.full(900, 1.0)
    best = Hypothesis((belt,), Fit((number, size), np.array([0.3, 1.0]), rows, np.ones((900, 2))))
    guessed = NoiseFloor(np.array([0.0, 800.0]), {}, from_repeats=False)
    for z, needed in ((1.5, False), (4.9, True)):
        retuned = Fit((number,), np.array([z]), 1.02 * rows, np.ones((900, 1)))
        assert _needed(best, retuned, guessed) is needed
