"""Put traps to `ffcomp record join` and `ffcomp diagnose`, as an owner does, and judge the answers.

    python -m validation.traps [NAME ...] --keep DIR        all traps if none is named; 1 to 2 min of computing each

Results of a whole round are in studies/archive/traps.md.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.cli import ffcomp
from validation.traps.bench import Trap, write
from validation.traps.catalogue import TRAPS

PROGRESS = ("ffcomp: reading", "ffcomp: joining")


@dataclass(frozen=True)
class Answer:
    """The answer of a verb: its JSON (empty where it refused), its messages, its exit code, and CPU seconds."""

    found: dict[str, Any]
    text: str
    code: int
    cpu_s: float


def joined(trap: Trap, keep: Path) -> Answer:
    """Write the captures of a trap and join them: `found` is ffcomp-join/1."""
    folder = keep / trap.name
    captures = write(trap, folder)
    shutil.rmtree(folder / "runs", ignore_errors=True)
    axes = ["--axes-map", trap.axes_map] if trap.axes_map else []
    files = ["--plan", folder / "moves.json", "-m", folder / "machine.toml", "--output-dir", folder / "runs"]
    answer = _called(["record", "join", *captures, *files, *axes, "--json"])
    refusals = [f"{Path(each['file']).name}: {each['why']}" for each in answer.found.get("refused", ())]
    return Answer(answer.found, " ".join([*refusals, answer.text]), answer.code, answer.cpu_s)


def diagnosed(trap: Trap, keep: Path, before: Answer) -> Answer:
    """Diagnose what was joined; where nothing was, `before` is the answer."""
    if before.code:
        return Answer({}, before.text, before.code, before.cpu_s)
    folder = keep / trap.name
    runs, better = sorted((folder / "runs").glob("*.csv")), folder / "better.toml"
    better.unlink(missing_ok=True)
    answer = _called(["diagnose", *runs, "-m", folder / "machine.toml", "-o", better, "--json", "-q"])
    text = " ".join([before.text, answer.text, *answer.found.get("said", ())])
    return Answer(answer.found, text, answer.code, before.cpu_s + answer.cpu_s)


def _called(words: Sequence[object]) -> Answer:
    """Call a verb in this process."""
    began, answer = time.process_time(), ffcomp(*words)
    found = json.loads(answer.stdout) if answer.stdout.strip() else {}
    lines = [line for line in answer.stderr.splitlines() if not line.startswith(PROGRESS)]
    return Answer(found, "\n".join(lines), answer.exit_code, time.process_time() - began)


def judged(trap: Trap, answer: Answer) -> list[str]:
    """List forbidden statements that an answer makes, and required ones that it lacks."""
    said, found = trap.said, answer.found
    wrong = [f"does not say /{p}/" for p in said.must if not re.search(p, answer.text, re.I)]
    wrong += [f"says /{p}/" for p in said.must_not if re.search(p, answer.text, re.I)]
    if not found:
        return wrong if said.refused else [*wrong, f"refused: {answer.text.strip()[:300]}"]
    if found["verdict"] not in said.verdicts:
        wrong.append(f"verdict {found['verdict']}")
    named = {e["name"]: e for e in found["effects"]}
    if said.names is not None:
        wrong += [f"names {name}" for name in named if name not in said.names]
    for key, (low, high) in said.values.items():
        effect, _, number = key.partition(".")
        if effect in named and not _reaches(named[effect]["parameters"][number], low, high):
            wrong.append(f"{key} {named[effect]['parameters'][number]}")
    if said.file is not None and bool(found.get("machine")) != said.file:
        wrong.append(f"a better file is {'written' if found.get('machine') else 'not written'}")
    return wrong


def _reaches(told: dict[str, Any], low: float, high: float) -> bool:
    """Tell whether an interval, or the mean of three, touches the span of what is right."""
    mean = {key: sum(x) / len(x) if isinstance(x, list) else x for key, x in told.items()}
    return bool(mean["low"] <= high and mean["high"] >= low)


def main(arguments: list[str]) -> int:
    """Run the traps, print a line for each, and return 1 if any was answered wrongly."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--keep", type=Path, required=True)
    given = parser.parse_args(arguments)
    failed = 0
    for trap in TRAPS:
        if given.names and trap.name not in given.names:
            continue
        answer = diagnosed(trap, given.keep, joined(trap, given.keep))
        wrong = judged(trap, answer)
        failed += bool(wrong)
        names = "+".join(e["name"] for e in answer.found.get("effects", ()))
        verdict = f"{answer.found.get('verdict', 'refused')} {names}, {answer.cpu_s:.0f} s"
        print(f"{'WRONG' if wrong else 'right'} {trap.name}: {verdict}", *wrong, sep="\n    ", flush=True)
        (given.keep / trap.name / "answer.json").write_text(json.dumps({"text": answer.text, **answer.found}, indent=1))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
