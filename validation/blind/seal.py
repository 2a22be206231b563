"""Where a case is written, and how its truth stays apart until every verdict is written.

DIR/cases/case-001/machine.toml, runs/*.csv   all that a diagnosis is given
DIR/verdicts/case-001.json, .toml             what it said, and the machine file it wrote
DIR/sealed/case-001/label.json, fresh/*.csv   the truth, and runs for the proof
DIR/seals/case-001.sha256                     SHA-256 of the label, from before the first verdict
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ffcomp.errors import FfcompError
from validation.blind.cases import Case, Circumstances, Label
from validation.blind.visible import Visibility


class SealedError(FfcompError):
    """The labels may not be read yet, or are not those that were sealed."""


def write_case(bank: Path, name: str, made: Case) -> None:
    """Write the case and its seal; `seals.json` keeps those that are there."""
    for folder, texts in ((bank / "cases" / name / "runs", made.runs), (bank / "sealed" / name / "fresh", made.fresh)):
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8")
    (bank / "cases" / name / "machine.toml").write_text(made.machine, encoding="utf-8")
    text = json.dumps(asdict(made.label), indent=1, default=_plain)
    label_path(bank, name).write_text(text, encoding="utf-8")
    seal = bank / "seals" / f"{name}.sha256"
    seal.parent.mkdir(exist_ok=True)
    seal.write_text(hashlib.sha256(text.encode()).hexdigest() + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """Return numpy's numbers as Python's."""
    return value.tolist()


def label_path(bank: Path, name: str) -> Path:
    """Return where a case's label is."""
    return bank / "sealed" / name / "label.json"


def refusal_path(bank: Path, name: str) -> Path:
    """Return where it is noted why a case has no runs."""
    return bank / "refused" / f"{name}.json"


def verdict_path(bank: Path, name: str) -> Path:
    """Return where a case's verdict is written."""
    return bank / "verdicts" / f"{name}.json"


def cases_of(bank: Path) -> list[str]:
    """Return the names of a bank's cases."""
    return sorted(path.stem for path in (bank / "seals").glob("*.sha256"))


def open_labels(bank: Path, names: Sequence[str]) -> dict[str, Label]:
    """Return the labels of these cases.

    Raises
    ------
    SealedError
        If a verdict is still missing, or a label has been changed since it was sealed.
    """
    missing = [name for name in names if not verdict_path(bank, name).exists()]
    if missing:
        raise SealedError(f"{len(missing)} verdicts are not written yet, {missing[0]} first; the labels stay sealed.")
    return opened(bank, names)


def opened(bank: Path, names: Sequence[str]) -> dict[str, Label]:
    """Return labels whose seals are whole, for someone who has all answers.

    Raises
    ------
    SealedError
    """
    seals = {name: (bank / "seals" / f"{name}.sha256").read_text(encoding="utf-8").strip() for name in names}
    return {name: _opened(label_path(bank, name), seals[name]) for name in names}


def _opened(path: Path, seal: str) -> Label:
    text = path.read_text(encoding="utf-8")
    if hashlib.sha256(text.encode()).hexdigest() != seal:
        raise SealedError(f"{path}: this label is not the one that was sealed.")
    found = json.loads(text)
    seen = {name: Visibility(**values) for name, values in found["visibility"].items()}
    around, alike = Circumstances(**found["around"]), tuple(found["alike"])
    return Label(**{**found, "visibility": seen, "around": around, "alike": alike})
