"""How much a search simulates: glimpses rank as all motions do, and a budget ends it with a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from ffcomp.diagnosis.axis_problem import STEP_COST, AxisProblem
from ffcomp.diagnosis.diagnosis import Diagnosis, diagnose
from ffcomp.diagnosis.result import result_of
from ffcomp.diagnosis.verb import result_json
from ffcomp.measurement.axis_run import AxisRun
from models.effects.catalogue import with_effects
from models.kinds import machine_of_axis
from models.printer.one_axis import simulate_axis
from models.vibration.driven_axis import DrivenAxis

RATE, ROWS, MOTIONS = 500.0, 700, 5
DRIVE = machine_of_axis("drive", DrivenAxis("position", 2.0, 2e4, 30.0), uncertainty={"default": 0.02})
FRICTION = "effects.coulomb_friction.force_n"
MILLION = 1e6


def problem(names: Sequence[str] = ("coulomb_friction", "belt_hardening", "guide_damping")) -> AxisProblem:
    """Five motions, the first one twice, of a drive with dry friction; the third is the loudest."""
    hidden, runs = with_effects(DRIVE, {"coulomb_friction": {"force_n": 4.0}}), []
    t = np.arange(ROWS) / RATE
    for motion in range(MOTIONS):
        rng = np.random.default_rng(motion)
        wave = np.interp(t, np.linspace(0, t[-1], 20), np.r_[0, rng.normal(size=18), 0])
        given = (12.0 if motion == 2 else 3.0) * np.convolve(wave, np.hanning(41) / 20, "same")
        felt = simulate_axis(hidden, given, 1 / RATE).acceleration
        for k in (1, 2) if motion == 0 else (1,):
            noisy = {"acc_q": felt + 0.03 * rng.normal(size=ROWS)}
            runs.append(AxisRun(f"{'abcde'[motion]}-{k}.csv", t, given, False, noisy, {}, {}))
    return AxisProblem(DRIVE, runs, names)


@cache
def searched(budget: float | None) -> tuple[AxisProblem, Diagnosis]:
    asked = problem()
    return asked, diagnose(asked, budget=budget)


def test_a_small_case_is_named_within_few_steps() -> None:
    asked, found = searched(None)
    assert found.verdict == "effects" and found.named is not None and found.named.names == ("coulomb_friction",)
    assert found.final.values[FRICTION] == pytest.approx(4.0, rel=0.05)
    assert not found.cut_short
    assert asked.work.steps < 3.3 * MILLION * STEP_COST


def test_a_search_ends_at_its_budget_and_says_so() -> None:
    asked, found = searched(0.1 * MILLION)
    assert found.cut_short
    assert asked.work.steps < 0.95 * searched(None)[0].work.steps
    told = result_json(result_of(asked, found))
    assert told["cut_short"] and any("--thorough" in sentence for sentence in told["said"])
    whole = result_json(result_of(*searched(None)))
    assert not whole["cut_short"] and not any("--thorough" in sentence for sentence in whole["said"])
