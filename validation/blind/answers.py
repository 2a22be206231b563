"""Others' answers: one JSON file for all cases, or a folder with one verdict of `ffcomp diagnose --json` for each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ffcomp.errors import MeasurementError

SCHEMA = "ffcomp-bank-answers/1"
VERDICTS = ("effects", "none", "unknown", "failed")


def read_answers(path: Path) -> dict[str, dict[str, Any]]:
    """Return the verdict of each case.

    Raises
    ------
    MeasurementError
        With every mistake in the answers.
    """
    if path.is_dir():
        files = [file for file in sorted(path.glob("*.json")) if not file.stem.endswith("-proof")]
        found = {file.stem: _json(file) for file in files}
    else:
        whole = _json(path)
        if (
            not isinstance(whole, Mapping)
            or whole.get("schema") != SCHEMA
            or not isinstance(whole.get("answers"), dict)
        ):
            raise MeasurementError(
                str(path), [f'It needs "schema": "{SCHEMA}", and "answers" with a verdict for each case by its name.']
            )
        found = whole["answers"]
    problems = [f"{name}: {why}" for name, answer in found.items() if (why := _mistake(answer))]
    if problems:
        raise MeasurementError(str(path), problems)
    return {name: _complete(answer) for name, answer in found.items()}


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise MeasurementError(str(path), [f"It is no JSON: {error}."]) from None


def _mistake(answer: Any) -> str:
    """Say what is wrong with one answer; "" if nothing is."""
    if not isinstance(answer, Mapping) or answer.get("verdict") not in VERDICTS:
        return f'"verdict" must be one of {", ".join(VERDICTS)}.'
    named = answer.get("effects", [])
    if not isinstance(named, list) or not all(isinstance(each, str | Mapping) for each in named):
        return '"effects" must be a list of names, or of objects with "name" and "parameters".'
    if any(isinstance(each, Mapping) and not isinstance(each.get("name"), str) for each in named):
        return 'each of "effects" needs a "name".'
    if answer["verdict"] == "effects" and not named:
        return 'the verdict "effects" needs at least one of "effects".'
    return ""


def _complete(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Return an answer in the form of a verdict: names alone have no parameters."""
    effects = [each if isinstance(each, Mapping) else {"name": each} for each in answer.get("effects", [])]
    alike = [each if isinstance(each, Mapping) else {"name": each} for each in answer.get("confusable_with", [])]
    return {**answer, "effects": [{"parameters": {}, **each} for each in effects], "confusable_with": alike}
