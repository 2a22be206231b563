"""Warnings for people: at most five lines, one for each cause, with places, seconds and what would avoid it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.compensate.warning_lines import MOST_LINES, grouped, shortened, warning_lines
from ffcomp.inverse.time_scaling import TimeScaling
from models.file import load_machine
from models.machine import Machine


def scaled(limit: str = "", carriage: str = "", seconds: float = 0.1, asked: float = 1.2) -> TimeScaling:
    return TimeScaling(10, 12, 3, 0.7, seconds, carriage, limit, asked)


@pytest.fixture(scope="module")
def ender() -> Machine:
    return load_machine("ender-3")


def test_each_limit_is_a_line_with_places_seconds_and_the_remedy(ender: Machine) -> None:
    slowed = [scaled("acceleration", "A", 0.5)] * 3 + [scaled("acceleration", "B", 0.25, 1.5), scaled("velocity", "C")]
    first, second = warning_lines([], slowed, ender, 350.0)
    assert first.startswith("Slowed at 4 places, 1.8 s longer in all (+0.5 %): the acceleration limit of ")
    assert "axis X (3×), axis Y (1×) was exceeded up to 1.50 times" in first
    value = ender.limits.carriage_acceleration_mm_per_s2
    assert f"carriage_acceleration_mm_per_s2 = {value:g} in [limits]" in first
    assert second.startswith("Slowed at 1 place, 0.1 s longer in all (+0.029 %): the velocity limit of axis Z was")


@pytest.mark.parametrize(
    ("name", "who"), [("voron-300", "motor A (1×), axis Z (1×)"), ("kossel", "carriage A (1×), carriage C (1×)")]
)
def test_whose_limit_it_is_in_the_words_of_the_machine(name: str, who: str) -> None:
    (line,) = warning_lines([], [scaled("velocity", "A"), scaled("velocity", "C")], load_machine(name), 10.0)
    assert f"limit of {who} was" in line


def test_a_board_that_makes_too_few_steps_is_named(ender: Machine) -> None:
    slow = replace(ender, limits=replace(ender.limits, step_rate_hz=4000.0))
    assert "or step_rate_hz = 4000," in warning_lines([], [scaled("velocity", "A")], slow, 10.0)[0]


def test_thousands_of_places_are_a_line(ender: Machine) -> None:
    exceeded = [f"line {k}: the command needs 1.0{k} times a limit." for k in range(9)]
    lines = warning_lines(exceeded, [scaled()] * 2117, ender, 4e3)
    assert len(lines) == 2
    assert lines[0].startswith("line 0: the command needs 1.00 times a limit. 8 more like this: see --json")
    assert lines[1].startswith("Slowed at 2117 places, 212 s longer in all (+5.3 %): the firmware's own acceleration")


def test_never_more_than_five_lines() -> None:
    lines = shortened([f"cause {letter}" for letter in "abcdefgh"])
    assert len(lines) == MOST_LINES == 5 and lines[-1].startswith("4 more kinds of warnings: see --json")
    assert shortened(["a", "b"]) == ["a", "b"]
    assert len(shortened([f"cause {letter}" for letter in "abcde"], most=4)) == 4


def test_what_differs_in_numbers_only_is_one_cause() -> None:
    assert grouped(["line 3: odd.", "line 40: odd.", "another"]) == [
        "line 3: odd. 1 more like this: see --json, or the log (ffcomp --log-path).",
        "another",
    ]
