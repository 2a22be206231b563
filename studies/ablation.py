"""What each rule of the search of `diagnose` is worth: a made benchmark, asked with each rule switched off in turn.

    python -m studies.ablation BENCHMARK OUT [--every N] [--rules RULE ...]

Prints a table in Markdown. BENCHMARK is a folder that `studies.diagnosis` made; its labels are opened. Answers are kept
in OUT, so that it can be stopped and continued. The rule "none off" is the search as it is.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ffcomp.api.measurements import diagnose
from ffcomp.diagnosis.settings import SETTINGS, SearchSettings
from ffcomp.errors import FfcompError
from validation.blind import score
from validation.blind.bank import opened

OFF: Mapping[str, SearchSettings] = {
    "none off": SETTINGS,
    "beam: one hypothesis a level": replace(SETTINGS, width=1),
    "other forms of an effect": replace(SETTINGS, forms=0),
    "an excerpt of long recordings": replace(SETTINGS, excerpt_information=np.inf),
    "coarse simulations": replace(SETTINGS, coarse_error=0.0),
    "the loudest motions first": replace(SETTINGS, subset_worth=0.0),
    "a second effect": replace(SETTINGS, most_effects=1),
}


def main() -> None:
    """Ask and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("benchmark", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--every", type=int, default=1, help="ask every Nth case only")
    parser.add_argument("--rules", nargs="*", default=list(OFF), metavar="RULE")
    given = parser.parse_args()
    names = [path.name for path in sorted((given.benchmark / "cases").iterdir())][:: given.every]
    for rule in given.rules:
        for name in names:
            asked(given.benchmark / "cases" / name, answer_path(given.out, rule, name), OFF[rule])
    labels = opened(given.benchmark, names)
    print("| switched off | singles | pairs | nothing hidden | outside | wrong | CPU, median (worst), s |")
    print("|---|---|---|---|---|---|---|")
    for rule in given.rules:
        answers = {name: json.loads(answer_path(given.out, rule, name).read_text("utf-8")) for name in names}
        judged = [score.Judged(name, labels[name], answers[name]) for name in names]
        print(row(rule, judged, [answers[name]["cpu_seconds"] for name in names]))


def answer_path(out: Path, rule: str, name: str) -> Path:
    """Return where an answer is kept."""
    return out / rule.replace(" ", "_").replace(":", "") / f"{name}.json"


def asked(case: Path, path: Path, settings: SearchSettings) -> None:
    """Ask for a verdict, unless it is there."""
    if path.exists():
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    began, runs = time.process_time(), sorted((case / "runs").glob("*.csv"))
    try:
        found = diagnose(runs, case / "machine.toml", settings=settings)
        answer = found.to_dict()
    except FfcompError as error:
        answer = {"verdict": score.FAILED, "why": str(error)}
    answer["cpu_seconds"] = time.process_time() - began
    path.write_text(json.dumps(answer), encoding="utf-8")
    print(f"{path.parent.name} {case.name}: {answer['verdict']}, {answer['cpu_seconds']:.0f} s", flush=True)


def row(rule: str, judged: list[score.Judged], cpu_s: list[float]) -> str:
    """Return a rule's row of the table: right verdicts by kind, cases with a wrong name, and CPU.

    Singles count if they are visible and named alone or with a rest, pairs if both are named.
    """
    singles = [j for j in judged if j.label.hides == "single" and j.label.visible]
    pairs = [j for j in judged if j.label.hides == "pair"]
    counts = [
        f"{sum(j.right_with_rest for j in singles)} of {len(singles)}",
        f"{sum(j.right for j in pairs)} of {len(pairs)}",
        counted(judged, "nothing"),
        counted(judged, "outside"),
        str(sum(bool(j.named - score.acceptable(j)) for j in judged)),
        f"{np.median(cpu_s):.0f} ({max(cpu_s):.0f})",
    ]
    return f"| {rule} | {' | '.join(counts)} |"


def counted(judged: list[score.Judged], hides: str) -> str:
    """Count the right verdicts of a kind of case, and its cases."""
    kind = [j for j in judged if j.label.hides == hides]
    return f"{sum(score.as_wanted(j) for j in kind)} of {len(kind)}"


if __name__ == "__main__":
    main()
