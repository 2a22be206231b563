"""Put traps to `ffcomp diagnose`, and judge what it says.

python -m validation.traps.run [NAME ...] --keep DIR        all traps if none is named; about a minute of computing each
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.traps.bench import write
from validation.traps.catalogue import TRAPS, Trap
from validation.traps.owners import CaptureTrap


@dataclass(frozen=True)
class Answer:
    """What a diagnosis said: its JSON (empty where it refused), its text, and its exit code."""

    found: dict[str, Any]
    text: str
    code: int
    cpu_s: float


def asked(trap: Trap, keep: Path) -> Answer:
    """Write the trap's files and diagnose them through the public verb."""
    from ffcomp.cli.app import app
    from ffcomp.cli.command import run

    folder = keep / trap.name
    runs = write(trap.bench, trap.spoils, folder, keep / "readings")
    out, err, code, began = io.StringIO(), io.StringIO(), 0, time.process_time()
    better = folder / "better.toml"
    better.unlink(missing_ok=True)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            run(
                app,
                ["diagnose", *map(str, runs), "-m", str(folder / "machine.toml"), "-o", str(better), "--json", "-q"],
            )
        except BaseException as error:  # typer's exit among them
            code = int(getattr(error, "exit_code", getattr(error, "code", 1)) or 0)
            if code == 1:
                raise
    found = json.loads(out.getvalue()) if out.getvalue().strip() else {}
    text = " ".join([err.getvalue(), *found.get("said", ())])
    return Answer(found, text, code, time.process_time() - began)


def judged(trap: Trap | CaptureTrap, answer: Answer) -> list[str]:
    """List what was said that must not be, and what was not said that must be."""
    said, found = trap.said, answer.found
    wrong = [f"does not say /{p}/" for p in said.must if not re.search(p, answer.text, re.I)]
    wrong += [f"says /{p}/" for p in said.must_not if re.search(p, answer.text, re.I)]
    if not found:
        return wrong if said.refused else [*wrong, f"refused: {answer.text.strip()[:300]}"]
    if found["verdict"] not in said.verdicts:
        wrong.append(f"verdict {found['verdict']}")
    if said.findings and found.get("finding") not in said.findings:
        wrong.append(f"finding {found.get('finding')}")
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
    """Run the traps, print a line each, and return 1 if any was answered wrongly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--keep", type=Path, required=True)
    given = parser.parse_args(arguments)
    failed = 0
    for trap in TRAPS:
        if given.names and trap.name not in given.names:
            continue
        answer = asked(trap, given.keep)
        wrong = judged(trap, answer)
        failed += bool(wrong)
        names = "+".join(e["name"] for e in answer.found.get("effects", ()))
        said = f"{answer.found.get('verdict', 'refused')} {answer.found.get('finding', '')} {names}"
        print(
            f"{'WRONG' if wrong else 'right'} {trap.name}: {said}, {answer.cpu_s:.0f} s",
            *wrong,
            sep="\n    ",
            flush=True,
        )
        (given.keep / trap.name / "answer.json").write_text(json.dumps({"text": answer.text, **answer.found}, indent=1))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
