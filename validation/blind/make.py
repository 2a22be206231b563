"""Make a bank, and score answers to it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ffcomp.errors import FfcompError, RequestError
from validation.blind.answers import read_answers
from validation.blind.cases import case
from validation.blind.score import Judged
from validation.blind.seal import cases_of, label_path, opened, refusal_path, write_case
from validation.blind.strata import full_bank
from validation.blind.summary import summary

Progress = Callable[[str], None]


def make_bank(
    folder: Path, count: int, seed: int, seconds: float, machines: Sequence[str], progress: Progress = lambda _: None
) -> list[str]:
    """Write cases and sealed labels; what is there is kept. Return the names of the cases, in order.

    A case whose captures `record join` refuses has no runs to diagnose: it is left out, and `refused/` says why.

    Raises
    ------
    RequestError
        If the folder holds a bank of other runs.
    """
    asked = {"seed": seed, "seconds": seconds, "machines": list(machines)}
    same_bank(folder, asked)
    wanted = full_bank(count, seed, machines)
    for number, (name, (seed_of_case, stratum)) in enumerate(wanted.items(), start=1):
        if not label_path(folder, name).exists():
            refusal = make_case(folder, name, seed_of_case, stratum, seconds)
            progress(f"{name}: {refusal or 'made'}, {number} of {count}")
    return [name for name in wanted if label_path(folder, name).exists()]


def make_case(folder: Path, name: str, seed: int, stratum: str, seconds: float) -> str | None:
    """Write a case and seal its label, or note and return why `record join` refuses its captures."""
    try:
        write_case(folder, name, case(seed, stratum, seconds))
    except FfcompError as error:
        refusal_path(folder, name).parent.mkdir(parents=True, exist_ok=True)
        refusal_path(folder, name).write_text(json.dumps({"why": str(error)}), encoding="utf-8")
        return f"no case, {str(error)[:200]}"
    return None


def same_bank(folder: Path, asked: dict[str, Any]) -> None:
    """Note what a bank is made of, or refuse another.

    Raises
    ------
    RequestError
    """
    made_with = folder / "bank.json"
    if not made_with.exists():
        folder.mkdir(parents=True, exist_ok=True)
        made_with.write_text(json.dumps(asked), encoding="utf-8")
    if (before := json.loads(made_with.read_text(encoding="utf-8"))) != asked:
        raise RequestError(f"{folder} holds a bank of {before}, not of {asked}: take the same, or another folder.")


def score_bank(folder: Path, answers: Path, partial: bool = False) -> dict[str, Any]:
    """Open the seals of the answered cases, and score the answers.

    Raises
    ------
    MeasurementError, RequestError, SealedError
    """
    known, given = cases_of(folder), read_answers(answers)
    if not known:
        raise RequestError(f"{folder} holds no bank: python -m validation.blind make -o {folder} makes one.")
    if strange := sorted(set(given) - set(known)):
        raise RequestError(f"{answers} answers {strange[0]}, which is no case of {folder}.")
    missing = [name for name in known if name not in given]
    if missing and not partial:
        raise RequestError(
            f"{len(missing)} of {len(known)} cases are not answered, {missing[0]} first; the labels stay sealed. "
            "--partial scores the others."
        )
    done = [name for name in known if name in given]
    labels = opened(folder, done)
    return {**summary([Judged(name, labels[name], given[name]) for name in done]), "unanswered": len(missing)}
