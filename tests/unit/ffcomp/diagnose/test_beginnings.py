"""Fits that begin with the motions' beginnings find play so wide that no slope points the way from the file."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ffcomp.api.measurements import recordings_of
from ffcomp.diagnose.beginnings import from_beginnings
from ffcomp.diagnose.diagnosis import noise_floor
from ffcomp.diagnose.estimation import EstimationProblem, estimation_problem
from ffcomp.diagnose.fit import Fit, derivatives, fit
from ffcomp.diagnose.hypotheses import discrepancy_of, within_file
from ffcomp.diagnose.noise import whitener
from ffcomp.diagnose.problems import problem_of
from ffcomp.diagnose.score_test import screen
from models.file import load_plant
from validation.blind.cases import case

NAMES = ("belt_backlash", "coulomb_friction", "belt_stiffness")
WIDTH = "effects.belt_backlash.width_mm"


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
    assert discrepancy_of(base) > 100.0  # times the noise, and so much in the dark
    screened = screen(estimation, base, estimation.problem.candidates)
    found = from_beginnings(estimation, screened, lambda said: None)
    assert found is not None and found.names == ("belt_backlash",) and within_file(found)
    assert found.discrepancy < 0.02 * discrepancy_of(base)
    widths = [found.fit.values[f"{WIDTH}[{i}]"] for i in range(2)]
    assert widths == pytest.approx(hidden["belt_backlash"]["width_mm"][:2], rel=0.03)  # type: ignore[index]


def test_where_nothing_explains_the_beginnings_nothing_is_followed(folder: Path) -> None:
    estimation, _ = printer("belt_backlash", 81234303, folder)
    base = retuned(estimation)
    others = [c for c in estimation.problem.candidates if c.name == "belt_stiffness"]
    assert from_beginnings(estimation, screen(estimation, base, others), lambda said: None) is None
