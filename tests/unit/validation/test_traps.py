"""The traps' bench and their judge; the traps that need no search, through the public verb."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from validation.traps.bench import Bench, recorded
from validation.traps.catalogue import TRAPS, Said, Trap
from validation.traps.run import Answer, asked, judged
from validation.traps.spoils import Shaped

BY_NAME = {trap.name: trap for trap in TRAPS}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("traps")


def test_names_are_unique_and_expectations_are_asked() -> None:
    assert len(BY_NAME) == len(TRAPS)
    for trap in TRAPS:
        assert trap.said != Said(), trap.name


def test_a_shaper_on_the_command_is_felt(kept: Path) -> None:
    plain, shaped = (
        recorded(Bench(noise=0.0, seconds=0.8, orders=orders), kept) for orders in ((), (Shaped("mzv", 42.0),))
    )
    assert [run.name for run in plain] == [run.name for run in shaped]
    assert shaped[0].signals["acc_x"].std() < 0.9 * plain[0].signals["acc_x"].std()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["warm-up", "dead-channel", "clipped-sensor", "shaper-on"])
def test_traps_that_need_no_search_are_answered_rightly(name: str, kept: Path) -> None:
    assert judged(BY_NAME[name], asked(BY_NAME[name], kept)) == []


def test_the_judge_finds_what_must_not_be_said() -> None:
    said = Said(("unknown",), names=(), must=("late",), must_not=("nothing is missing",), file=False)
    trap = replace(BY_NAME["nothing"], said=said)
    found = {"verdict": "none", "effects": [{"name": "cogging", "parameters": {}}], "machine": "better.toml"}
    wrong = judged(trap, Answer(found, "Nothing is missing.", 0, 1.0))
    assert len(wrong) == 5
    fine = {"verdict": "unknown", "effects": [], "machine": None}
    assert judged(trap, Answer(fine, "a.csv lies 2 ms late.", 0, 1.0)) == []
    refused = judged(trap, Answer({}, "late", 5, 1.0))
    assert refused == ["refused: late"]
    assert judged(Trap("x", "", Bench(), replace(said, refused=True)), Answer({}, "late", 5, 1.0)) == []


def test_an_interval_must_reach_what_is_right() -> None:
    trap = BY_NAME["camera"]
    for low, wrong in ((0.11, 0), (0.15, 1)):
        number = {"value": low + 0.01, "low": low, "high": low + 0.02}
        found = {"verdict": "effects", "effects": [{"name": "effector_mass", "parameters": {"added_kg": number}}]}
        assert len(judged(trap, Answer(found, "", 0, 1.0))) == wrong
