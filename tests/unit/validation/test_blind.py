"""The public form of the bank: cases and sealed labels, and the score of anybody's answers."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from ffcomp.errors import MeasurementError
from tests.support.json_page import Page
from validation.blind.__main__ import main
from validation.blind.bank import read_answers

Told = dict[str, Any]
PAGE = Path(__file__).parents[3] / "validation/blind/README.md"


def make(folder: Path, *options: str, seconds: float = 0.8) -> int:
    return main(["make", "-o", str(folder), "--cases", "2", "--machine", "axis", "--seconds", str(seconds), *options])


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bank")
    assert make(folder, "-q") == 0
    return folder


def labels(bank: Path) -> dict[str, Told]:
    return {path.parent.name: json.loads(path.read_text()) for path in sorted(bank.glob("sealed/*/label.json"))}


def answered(bank: Path, tmp_path: Path, answers: Told) -> Path:
    path = tmp_path / "answers.json"
    path.write_text(json.dumps({"schema": "ffcomp-bank-answers/1", "answers": answers}), encoding="utf-8")
    return path


def scored(bank: Path, answers: Path, capsys: pytest.CaptureFixture[str], *options: str) -> Told:
    capsys.readouterr()
    assert main(["score", str(bank), str(answers), "--json", *options]) == 0
    return dict(json.loads(capsys.readouterr().out))


def test_a_case_shows_nothing_of_its_label(bank: Path) -> None:
    found = labels(bank)
    assert len(found) == 2
    for name, label in found.items():
        given = "".join(p.read_text() for p in (bank / "cases" / name).rglob("*.*"))
        assert not any(word in given for word in (*label["effects"], label["outside"] or "outside", "label"))
        sealed = hashlib.sha256((bank / "sealed" / name / "label.json").read_bytes()).hexdigest()
        assert (bank / "seals" / f"{name}.sha256").read_text().strip() == sealed


def test_a_bank_goes_on_as_it_began(bank: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.stat().st_mtime_ns for path in bank.rglob("*.csv")}
    make(bank, "--json")
    printed = json.loads(capsys.readouterr().out)
    assert Page(PAGE).problems(printed, "ffcomp-bank/1") == []
    assert sorted(printed["cases"]) == sorted(labels(bank))
    assert before == {path: path.stat().st_mtime_ns for path in bank.rglob("*.csv")}
    assert make(bank, seconds=1.0) == 2


def test_right_and_wrong_answers_are_told_apart(bank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    right = {
        name: {"verdict": "effects", "effects": list(label["effects"])}
        if label["effects"]
        else {"verdict": "unknown" if label["outside"] else "none"}
        for name, label in labels(bank).items()
    }
    found = scored(bank, answered(bank, tmp_path, right), capsys)
    axis = next(each for each in found["strata"] if each["name"] == "axis")
    assert (found["schema"], found["cases"], found["misses"]) == ("ffcomp-bank-score/1", 2, [])
    assert (axis["hits"], axis["total"]) == (2, 2)
    assert axis["low"] == pytest.approx(0.342, abs=1e-3)
    wrong = {name: {"verdict": "effects", "effects": ["frame_mode"]} for name in right}
    found = scored(bank, answered(bank, tmp_path, wrong), capsys)
    assert Page(PAGE).problems(found, "ffcomp-bank-score/1") == []
    assert [each["said"] for each in found["misses"]] == ["frame_mode"] * 2


def test_labels_stay_sealed_until_all_is_answered(
    bank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = answered(bank, tmp_path, {sorted(labels(bank))[0]: {"verdict": "unknown"}})
    assert main(["score", str(bank), str(one)]) == 2
    assert "1 of 2 cases are not answered" in capsys.readouterr().err
    assert scored(bank, one, capsys, "--partial")["unanswered"] == 1


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ({"verdict": "perhaps"}, "must be one of effects, none, unknown"),
        ({"verdict": "effects"}, "needs at least one"),
        ({"verdict": "effects", "effects": "cogging"}, "must be a list"),
        ({"verdict": "effects", "effects": [{"parameters": {}}]}, 'needs a "name"'),
    ],
)
def test_mistakes_in_answers_are_named(answer: Told, why: str, tmp_path: Path) -> None:
    with pytest.raises(MeasurementError, match=why):
        read_answers(answered(tmp_path, tmp_path, {"case-1": answer}))
