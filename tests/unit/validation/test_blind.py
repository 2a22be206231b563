"""The public form of the bank: cases and sealed labels, and the score of anybody's answers."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from ffcomp.errors import MeasurementError
from validation.blind.__main__ import main
from validation.blind.bank import read_verdict, verdict_path

Told = dict[str, Any]


def make(folder: Path, seconds: float = 0.8) -> int:
    return main(["make", str(folder), "--cases", "2", "--machine", "axis", "--seconds", str(seconds)])


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bank")
    assert make(folder) == 0
    return folder


def labels(bank: Path) -> dict[str, Told]:
    return {path.parent.name: json.loads(path.read_text()) for path in sorted(bank.glob("sealed/*/label.json"))}


def scored(bank: Path, answers: Told, capsys: pytest.CaptureFixture[str]) -> list[str]:
    for name, answer in answers.items():
        verdict_path(bank, name).parent.mkdir(exist_ok=True)
        verdict_path(bank, name).write_text(json.dumps(answer), encoding="utf-8")
    capsys.readouterr()
    assert main(["score", str(bank)]) == 0
    return capsys.readouterr().out.splitlines()


def test_a_case_shows_nothing_of_its_label(bank: Path) -> None:
    found = labels(bank)
    assert len(found) == 2
    for name, label in found.items():
        given = "".join(p.read_text() for p in (bank / "cases" / name).rglob("*.*"))
        assert not any(word in given for word in (*label["effects"], label["outside"] or "outside", "label"))
        sealed = hashlib.sha256((bank / "sealed" / name / "label.json").read_bytes()).hexdigest()
        assert (bank / "seals" / f"{name}.sha256").read_text().strip() == sealed


def test_a_bank_goes_on_as_it_began(bank: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in bank.rglob("*.csv")}
    assert make(bank) == 0
    assert before == {path: path.stat().st_mtime_ns for path in bank.rglob("*.csv")}
    assert make(bank, seconds=1.0) == 2


def test_labels_stay_sealed_until_all_is_answered(bank: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", str(bank)]) != 0
    assert "2 verdicts are not written yet" in capsys.readouterr().err


def test_right_and_wrong_answers_are_told_apart(bank: Path, capsys: pytest.CaptureFixture[str]) -> None:
    right = {
        name: {"verdict": "effects", "effects": list(label["effects"])}
        if label["effects"]
        else {"verdict": "unknown" if label["outside"] else "none"}
        for name, label in labels(bank).items()
    }
    first, *others = scored(bank, right, capsys)
    assert first == "as it should be: 2 of 2, 95 % interval 34-100 %"
    assert not any("said" in line for line in others)
    wrong = {name: {"verdict": "effects", "effects": ["frame_mode"]} for name in right}
    told = scored(bank, wrong, capsys)
    assert told[0].startswith("as it should be: 0 of 2")
    assert [line.endswith("said frame_mode") for line in told[-2:]] == [True, True]


@pytest.mark.parametrize(
    "answer",
    ["perhaps", "effects", 'effects", "effects": "cogging', 'effects", "effects": [{"parameters": {}}], "a": "'],
)
def test_what_is_no_verdict_is_refused(answer: str, tmp_path: Path) -> None:
    (tmp_path / "case-1.json").write_text(f'{{"verdict": "{answer}"}}', encoding="utf-8")
    with pytest.raises(MeasurementError, match=r'case-1\.json: It is no verdict: "verdict" is one of effects, none,'):
        read_verdict(tmp_path / "case-1.json")
