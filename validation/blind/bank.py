"""The benchmark as a whole: which cases, where each is written, how its truth stays apart, answers and their score.

DIR/cases/case-001/machine.toml, runs/*.csv   all that a diagnosis is given
DIR/verdicts/case-001.json, .toml             its verdict, and the machine file it wrote
DIR/sealed/case-001/label.json                the truth
DIR/seals/case-001.sha256                     SHA-256 of the label, from before the first verdict
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.errors import FfcompError, MeasurementError, RequestError
from validation.blind.cases import NEVER_TOGETHER, Case, Label, case
from validation.blind.kinds import KINDS, MACHINES
from validation.blind.score import Judged
from validation.blind.visible import Visibility

VERDICTS = ("effects", "none", "unknown", "failed")
# of six cases on a machine three hide one effect, and one each two, nothing, and what is outside the catalogue
ROUND = ("single", "nothing", "single", "outside", "single", "pair")
# in turn, by machine and by what is hidden
CONDITIONS: Mapping[str, Sequence[str]] = {
    "delta": ("usual", "free-damping", "rest", "rough-file"),
    "nozzle": ("free-damping", "usual", "joined", "rest"),
    "cartesian": ("rest", "free-damping", "usual", "rough-file"),
    "corexy": ("joined", "rest", "free-damping", "usual"),
    "axis": ("rough-file", "usual", "rest", "free-damping"),
    "servo": ("usual", "rest", "rough-file"),
}
FULL = 240


def full_bank(
    count: int = FULL, seed: int = 1, machines: Sequence[str] = tuple(MACHINES)
) -> dict[str, tuple[int, str]]:
    """Return the name of each case → its seed and stratum; a larger bank begins with the smaller.

    The names carry no information. Machines come in turn; each goes through ROUND, from another place of it. Where a
    machine is of several kinds, they take turns.
    """
    cases: dict[str, tuple[int, str]] = {}
    kinds = [kind for machine in machines for kind in MACHINES[machine]]
    names = {(kind, what): _in_turn(kind, what, seed) for kind in kinds for what in set(ROUND)}
    seen: dict[tuple[str, str], int] = {}
    for n in range(count):
        turn, machine = n // len(machines), machines[n % len(machines)]
        which = list(MACHINES).index(machine)
        what = ROUND[(turn + which) % len(ROUND)]
        before = seen.get((machine, what), 0)
        seen[machine, what] = before + 1
        several, conditions = MACHINES[machine], CONDITIONS[machine]
        kind = several[before % len(several)]
        condition = conditions[before // len(several) % len(conditions)]
        if condition == "rest" and what != "single":  # that condition needs one effect
            condition = "usual"
        name = hashlib.sha256(f"{seed} {machine} {turn}".encode()).hexdigest()[:8]
        own = 10000 * seed + 100 * turn + which
        cases[f"case-{name}"] = (own, f"{kind}/{what}/{condition}:{next(names[kind, what])}")
    return cases


def _choices(machine: str, what: str) -> list[str]:
    kind = KINDS[machine]
    if what == "nothing":
        return ["none"]
    if what == "outside":
        return list(kind.outside)
    if what == "pair":
        pairs = [{a, b} for a, b in combinations(kind.effects, 2) if {a, b} not in NEVER_TOGETHER]
        return ["+".join(sorted(pair)) for pair in pairs]
    return list(kind.effects)


def _in_turn(machine: str, what: str, seed: int) -> Iterator[str]:
    """Each once in a shuffled order, then again in another; the same however many are wanted."""
    choices = _choices(machine, what)
    digest = hashlib.sha256(f"{machine} {what}".encode()).digest()
    rng = np.random.default_rng([seed, int.from_bytes(digest[:4], "big")])
    for _ in range(math.ceil(10000 / len(choices))):
        yield from map(str, rng.permutation(choices))


# ---- cases and their seals -----------------------------------------------------------------------


class SealedError(FfcompError):
    """The labels may not be read yet, or are not those that were sealed."""


def write_case(bank: Path, name: str, made: Case) -> None:
    """Write the case and its seal; `seals.json` keeps those that are there."""
    runs, label, seal = bank / "cases" / name / "runs", label_path(bank, name), bank / "seals" / f"{name}.sha256"
    for folder in (runs, label.parent, seal.parent):
        folder.mkdir(parents=True, exist_ok=True)
    for file, text in made.runs.items():
        (runs / file).write_text(text, encoding="utf-8")
    (runs.parent / "machine.toml").write_text(made.machine, encoding="utf-8")
    text = json.dumps(asdict(made.label), indent=1, default=_plain)
    label.write_text(text, encoding="utf-8")
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
    found.pop("around", None)  # older labels state how the file was measured
    return Label(**{**found, "visibility": seen, "alike": tuple(found["alike"])})


# ---- answers -------------------------------------------------------------------------------------


def judged_cases(bank: Path, names: Sequence[str]) -> list[Judged]:
    """Open the labels of these cases, which all have their verdicts, and put them next to each other.

    Raises
    ------
    MeasurementError
        With the first mistake in a verdict.
    SealedError
    """
    labels = open_labels(bank, names)
    return [Judged(name, label, read_verdict(verdict_path(bank, name))) for name, label in labels.items()]


def read_verdict(path: Path) -> dict[str, Any]:
    """Return a verdict as `ffcomp diagnose --json` prints it; effects may be names alone.

    Raises
    ------
    MeasurementError
    """
    try:
        answer = json.loads(path.read_text(encoding="utf-8"))
        named, alike = (
            [each if isinstance(each, Mapping) else {"name": each} for each in answer.get(key, ())]
            for key in ("effects", "confusable_with")
        )
        sound = answer["verdict"] in VERDICTS and all(isinstance(each["name"], str) for each in named)
        sound = sound and isinstance(answer.get("effects", []), list) and bool(named or answer["verdict"] != "effects")
    except (ValueError, AttributeError, KeyError, TypeError):
        sound = False
    if not sound:
        rule = f'"verdict" is one of {", ".join(VERDICTS)}, "effects" a list of names, or of objects with a "name".'
        raise MeasurementError(str(path), [f"It is no verdict: {rule}"])
    return {**answer, "effects": [{"parameters": {}, **each} for each in named], "confusable_with": alike}


def make_case(folder: Path, name: str, seed: int, stratum: str, seconds: float) -> str | None:
    """Write a case and seal its label, or note and return why `record join` refuses its captures."""
    try:
        write_case(folder, name, case(seed, stratum, seconds))
    except FfcompError as error:
        refusal_path(folder, name).parent.mkdir(parents=True, exist_ok=True)
        refusal_path(folder, name).write_text(json.dumps({"why": str(error)}), encoding="utf-8")
        return f"no case, {str(error)[:200]}"
    return None


def same_bank(folder: Path, seconds: float) -> None:
    """Note how long the runs of a bank are, or refuse one of other runs.

    Raises
    ------
    RequestError
    """
    made_with = folder / "bank.json"
    if not made_with.exists():
        folder.mkdir(parents=True, exist_ok=True)
        made_with.write_text(json.dumps({"seconds": seconds}), encoding="utf-8")
    if (before := json.loads(made_with.read_text(encoding="utf-8"))["seconds"]) != seconds:
        raise RequestError(f"{folder} holds runs of {before:g} s: continue it with --seconds {before:g}.")
