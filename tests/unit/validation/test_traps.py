"""The traps' judge; traps that need no search, through the public verb."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from validation.traps.__main__ import Answer, diagnosed, joined, judged
from validation.traps.catalogue import TRAPS, Said

BY_NAME = {trap.name: trap for trap in TRAPS}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("traps")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clipped", "copied", "overflows", "other-plan", "moved-chip", "all-halved"])
def test_traps_that_need_no_search_are_answered_rightly(name: str, kept: Path) -> None:
    trap = BY_NAME[name]
    assert judged(trap, diagnosed(trap, kept, joined(trap, kept))) == []


def test_the_judge_finds_what_must_not_be_said() -> None:
    said = Said(("unknown",), names=(), must=("late",), must_not=("nothing is missing",), file=False)
    trap = replace(BY_NAME["captures-plain"], said=said)
    found = {"verdict": "none", "effects": [{"name": "cogging", "parameters": {}}], "machine": "better.toml"}
    wrong = judged(trap, Answer(found, "Nothing is missing.", 0, 1.0))
    assert len(wrong) == 5
    fine = {"verdict": "unknown", "effects": [], "machine": None}
    assert judged(trap, Answer(fine, "a.csv lies 2 ms late.", 0, 1.0)) == []
    refused = judged(trap, Answer({}, "late", 5, 1.0))
    assert refused == ["refused: late"]
    assert judged(replace(trap, said=replace(said, refused=True)), Answer({}, "late", 5, 1.0)) == []
