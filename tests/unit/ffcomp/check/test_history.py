"""The history of checks: it keeps what it was given, stays small, and is never overwritten where it is damaged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.check.changes import Change, Difference, Explanation, SensorSignal
from ffcomp.check.compare import verdict
from ffcomp.check.history import MOST, WITH_MOTION, Check, read_history, write_history
from ffcomp.errors import MeasurementError

AXES = "x,y,z"


def light(date: str, plan: str = "p", seed: int = 0) -> Check:
    felt = SensorSignal("a", np.round(np.random.default_rng(seed).normal(size=(20, 3)), 3), np.full(3, 0.1), 1e-4)
    return Check(date, plan, "s", AXES, "same", "As before.", 0.1, 0.01, 0.01, (felt,))


def test_a_history_keeps_what_it_was_given_and_stays_small(tmp_path: Path) -> None:
    path = tmp_path / "checks.jsonl"
    write_history(path, [light(str(k), seed=k) for k in range(MOST + 7)])
    read = read_history(path)
    assert [each.date for each in read] == [str(k) for k in range(7, MOST + 7)]
    assert [bool(each.signals) for each in read] == [True, *[False] * (MOST - 1 - WITH_MOTION), *[True] * WITH_MOTION]
    assert np.array_equal(read[-1].signals[0].acceleration, light("", seed=MOST + 6).signals[0].acceleration)


@pytest.mark.parametrize("damage", ["half", "other", "numbers"])
def test_a_damaged_history_is_refused_and_not_overwritten(damage: str, tmp_path: Path) -> None:
    path = tmp_path / "checks.jsonl"
    write_history(path, [light("1"), light("2")])
    first, second = path.read_text(encoding="utf-8").splitlines()
    entry = json.loads(second)
    entry["experiments"][0]["acceleration_mm_per_s2"][0][3] = None
    texts = {"half": second[: len(second) // 2], "other": '{"schema": "else"}', "numbers": json.dumps(entry)}
    path.write_text(f"{first}\n{texts[damage]}\n", encoding="utf-8")
    with pytest.raises(MeasurementError, match="Line 2 of the history is no check of ffcomp"):
        read_history(path)


CLEAN = Difference(0.2, 0.01, 9.0, 900.0, (), 0.0, 0.0, 0.0)
BELT = Change("belts", "the belts are {size:.0f} % {way}", key=("carriage.mass_kg",), sd=0.1, low=-0.5, high=0.5)


@pytest.mark.parametrize(
    ("found", "axes", "finding", "words"),
    [
        (replace(CLEAN, times=1.0, size=0.01), AXES, "same", "As on 2026-11-15 20:00: it differs by 1.0%"),
        (replace(CLEAN, times=1.0), "y,x,z", "sensor", "turned since 2026-11-15 20:00: the printer's axes were x,y,z"),
        (replace(CLEAN, times=1.0, noise=0.3), AXES, "cannot_tell", "noise is 30% of the signal. Tighten"),
        (replace(CLEAN, sensor_share=0.95, gain=-0.1), AXES, "sensor", "reads 10% less of the same motion"),
        (replace(CLEAN, sensor_share=0.95, turned_deg=-5.0), AXES, "sensor", "is turned by 5° about the vertical"),
        (replace(CLEAN, sensor_share=0.95), AXES, "unknown", "No single part explains it"),
        (replace(CLEAN, explanations=(Explanation(BELT, -0.1, 0.01, 0.97),)), AXES, "changed", "explains 97% of it."),
        (
            replace(CLEAN, explanations=tuple(Explanation(BELT, size, 0.01, 0.97) for size in (-0.1, 0.1))),
            *(AXES, "changed", "10 % lower, or the belts are 10 % higher: that explains 97% of it. The check cannot"),
        ),
    ],
)
def test_what_a_difference_means(found: Difference, axes: str, finding: str, words: str) -> None:
    said = verdict(found, light("2026-11-15T20:00"), axes)
    assert said.finding == finding and words in said.message, said
