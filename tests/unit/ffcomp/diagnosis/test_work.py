"""How much a search simulates: glimpses rank as all motions do, and a budget ends it with a sentence."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ffcomp.diagnosis.axis_problem import STEP_COST, AxisProblem
from ffcomp.diagnosis.diagnosis import Outcome, diagnose
from ffcomp.diagnosis.observations import EXCERPT_MOTIONS, EXCERPT_S, informative_recordings
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.problem import Observation
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.sentences import summary_sentences
from ffcomp.diagnosis.trace import Trace
from ffcomp.measurement.axis_run import AxisRun
from ffcomp.measurement.recording import Recording
from models.effects.catalogue import with_effects
from models.file import load_machine
from models.kinds import machine_of_axis
from models.printer.one_axis import simulate_axis
from models.vibration.driven_axis import DrivenAxis

RATE, ROWS, MOTIONS = 500.0, 700, 5
DRIVE = machine_of_axis("drive", DrivenAxis("position", 2.0, 2e4, 30.0), uncertainty={"default": 0.02})
FRICTION = "effects.coulomb_friction.force_n"


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
            runs.append(AxisRun(f"{'abcde'[motion]}-{k}.csv", t, given, "position", noisy, {}))
    return AxisProblem(DRIVE, runs, names)


@cache
def searched(budget: float | None) -> tuple[AxisProblem, Outcome]:
    asked = problem()
    return asked, diagnose(asked, budget=budget)


def test_a_small_case_is_named_within_few_steps() -> None:
    asked, found = searched(None)
    assert found.verdict == "effects" and found.named is not None and found.named.names == ("coulomb_friction",)
    assert found.final.values[FRICTION] == pytest.approx(4.0, rel=0.05)
    assert not found.cut_short
    assert asked.work.steps < 3.3e6 * STEP_COST


def test_a_search_ends_at_its_budget_and_says_so() -> None:
    asked, found = searched(1e5)
    assert found.cut_short
    assert asked.work.steps < searched(None)[0].work.steps
    told = DiagnosisResult(search=found)
    assert any("--thorough" in sentence for sentence in summary_sentences(told))
    whole = DiagnosisResult(search=searched(None)[1])
    assert not any("--thorough" in sentence for sentence in summary_sentences(whole))


def test_every_fit_and_every_decision_is_in_the_trace(tmp_path: Path) -> None:
    trace = Trace()
    found = diagnose(problem(), trace=trace)
    assert found.named is not None and found.named.names == ("coulomb_friction",)
    fits = [r for r in trace.records if r.step.startswith("fit")]
    assert {"coulomb_friction", "guide_damping"} <= {name for r in fits for name in r.effects}
    assert all(r.evidence is not None and r.left is not None and r.parameters for r in fits)
    assert sum(r.evaluations for r in trace.records) > 100
    pruned = [r for r in trace.records if r.step == "prune"]
    assert {r.outcome for r in pruned} == {"kept", "dropped"}
    assert [(r.effects, r.outcome) for r in trace.records if r.step == "accept"] == [(("coulomb_friction",), "kept")]
    trace.write(tmp_path / "trace.json")
    written = json.loads((tmp_path / "trace.json").read_text(encoding="utf-8"))
    assert len(written) == len(trace.records) and written[-1]["effects"] == ["coulomb_friction"]


RATE_HZ, SECONDS = 1591.5, 4.0
DRIFT = "effects.sensor_clock_drift.relative_drift"


@cache
def problem_of_excerpts() -> PrinterProblem:
    """Two motions, one of them twice, with noise and no signal: only lengths and commands matter."""
    return noisy({"a-1": (9.0, "Axyz"), "a-2": (9.0, "Axyz"), "b-1": (17.0, "Axyz")}, {})


def noisy(runs: dict[str, tuple[float, str]], said: dict[str, str]) -> PrinterProblem:
    """A printer that makes circles of these frequencies, rad/s, and feels noise along these axes."""
    machine, rng = load_machine("mp-delta-pro"), np.random.default_rng(4)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    fade = np.clip(np.minimum(t, t[-1] - t) / 0.3, 0, 1)[:, None]
    recordings = []
    for name, (f, axes) in runs.items():
        nozzle = [10.0, -5.0, 30.0] + fade * np.column_stack([np.sin(f * t), np.cos(2 * f * t), np.sin(3 * f * t) / 2])
        felt = {f"acc_{axis}": rng.standard_normal(len(t)) for axis in axes}
        q = machine.kinematics.inverse(nozzle)
        recordings.append(Recording(f"{name}.csv", t, q, "carriage", felt, {}, said))
    return PrinterProblem(machine, recordings, ("coulomb_friction",))


@pytest.mark.parametrize(("values", "tolerance"), [({}, 5e-3), ({FRICTION: 2.0}, 0.02), ({DRIFT: 3e-4}, 5e-3)])
def test_an_excerpt_is_simulated_as_the_whole_is(values: dict[str, float], tolerance: float) -> None:
    whole, part = problem_of_excerpts(), problem_of_excerpts().excerpt()
    assert part is not None
    for long, short, rows in zip(whole.simulate(values), part.simulate(values), part.parts, strict=True):
        there = long[rows.first : rows.last]
        assert len(short) == rows.last - rows.first == pytest.approx(EXCERPT_S * RATE_HZ, rel=0.02)
        np.testing.assert_allclose(short, there, atol=tolerance * np.abs(there).max())


def test_of_many_motions_a_few_of_every_place_and_kind_are_searched_in() -> None:
    """Three kinds at three places, each twice, and each a few mm beside the one before."""
    places, rows = ((0.0, 0.0), (-70.0, -60.0), (60.0, 50.0)), np.zeros((10, 1))
    runs = [
        Observation(f"{kind}{i}.csv", kind, (x + 5.0 * i, y), 1600.0, ("acc_x",), rows, rows)
        for x, y in places
        for i, kind in enumerate("aabbcc")
    ]
    same = [i - i % 2 for i in range(18)]
    chosen = informative_recordings(runs, same)
    assert len(chosen) == EXCERPT_MOTIONS and all(same[i] == i for i in chosen)  # no repeats
    assert {runs[i].repeat_of for i in chosen} == set("abc")
    assert {i // 6 for i in chosen} == {0, 1, 2}
    assert informative_recordings(runs[:12], same[:12]) == list(range(12))  # of few motions all
    runs[1] = replace(runs[1], signals=("acc_y",))  # a repeat that measured something else
    assert informative_recordings(runs, same)[:2] == [0, 1]
