"""What owners get wrong, and what is then said: the traps of `validation/traps`, through the public verbs.

    python -m studies.traps --keep DIR [NAME ...] --write       studies/reports/traps.md

Answers stay in DIR; what is there is not asked again, and is judged anew. NAMEs ask only those. `--join` stops before
the diagnosis, which takes most of the time. Run it with OPENBLAS_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from studies.render import save
from validation.traps import ask
from validation.traps.catalogue import TRAPS, Trap
from validation.traps.owners import CAPTURE_TRAPS, CaptureTrap
from validation.traps.run import Answer, asked, judged

NOTICED = 230  # letters of an answer in the page
REFUSED = 5  # exit code


def main() -> None:
    """Ask, judge, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these traps")
    parser.add_argument("--keep", required=True, type=Path, metavar="DIR", help="where files and answers are kept")
    parser.add_argument("--join", action="store_true", help="only join the captures")
    parser.add_argument("--write", action="store_true", help="write the results and the page, of all answers there are")
    options = parser.parse_args()
    rows: dict[str, list[dict[str, Any]]] = {"runs": [], "captures": []}
    unasked: list[str] = []
    traps: tuple[Trap | CaptureTrap, ...] = (*TRAPS, *CAPTURE_TRAPS)
    for trap in traps:
        wanted = not options.names or trap.name in options.names
        answer = _answer(trap, options.keep, ask_it=wanted, join_only=options.join)
        if answer is None:
            unasked.append(f"{trap.about} ({trap.hidden if isinstance(trap, CaptureTrap) else _hidden(trap)} hidden)")
            continue
        row = _row(trap, answer)
        rows["runs" if isinstance(trap, Trap) else "captures"].append(row)
        if wanted:
            print("right" if row["right"] else "WRONG", trap.name, row["said"], *row["wrong"], sep="\n    ", flush=True)
    if options.write:
        save("traps", {**rows, "unasked": unasked})
    sys.exit(not all(row["right"] for each in rows.values() for row in each))


def _answer(trap: Trap | CaptureTrap, keep: Path, *, ask_it: bool, join_only: bool) -> Answer | None:
    """Return the answer that is kept, or ask for it."""
    kept = keep / trap.name / "said.json"
    if kept.exists():
        return Answer(**json.loads(kept.read_text(encoding="utf-8")))
    if not ask_it or (join_only and isinstance(trap, Trap)):
        return None
    if isinstance(trap, Trap):
        answer = asked(trap, keep)
    else:
        joined = ask.joined(trap, keep)
        if join_only and not joined.code:
            print("joined", trap.name, joined.text, sep="\n    ", flush=True)
            return None
        answer = ask.diagnosed(trap, keep, joined)
    kept.write_text(json.dumps(asdict(answer), indent=1, ensure_ascii=False), encoding="utf-8")
    return answer


def _row(trap: Trap | CaptureTrap, answer: Answer) -> dict[str, Any]:
    wrong = judged(trap, answer)
    return {
        "name": trap.name,
        "about": trap.about,
        "hidden": trap.hidden if isinstance(trap, CaptureTrap) else _hidden(trap),
        "said": _said(answer),
        "right": not wrong,
        "wrong": wrong,
    }


def _hidden(trap: Trap) -> str:
    """Say what the printer of a bench hides."""
    friction = "2.5 N of dry friction" if trap.bench.fields else ""
    camera = f"{1e3 * trap.bench.added_kg:.0f} g" if trap.bench.added_kg else ""
    return " and ".join(filter(None, (friction, camera))) or (
        "friction that goes" if trap.bench.in_repeat else "nothing"
    )


def _said(answer: Answer) -> str:
    """Shorten an answer for the page: the verdict and its first words, or the refusal's."""
    if not answer.found or "verdict" not in answer.found:
        what = "refused: " if answer.code == REFUSED else f"exit code {answer.code}, no verdict: "
        return what + _cut(re.sub(r"\S*?([\w.-]+\.csv): ", r"\1: ", answer.text.replace("ffcomp: ", "")))
    found = answer.found
    named = [f"{e['name']} ({', '.join(_size(k, x) for k, x in e['parameters'].items())})" for e in found["effects"]]
    words = found.get("said") or [""]
    left_out = re.match(r"[\w.-]+\.csv: ", answer.text)  # some captures were refused, and the others diagnosed
    before = f"left out: {_cut(answer.text)} Then " if left_out else ""
    return f"{before}{' + '.join(named) or found['verdict']}: {_cut(words[0])}"


def _size(key: str, told: Mapping[str, Any]) -> str:
    value, low, high = (_digits(told[name]) for name in ("value", "low", "high"))
    return f"{key} {value}" if value == low == high else f"{key} {value}, {low} to {high}"


def _digits(x: Any) -> str:
    if isinstance(x, list):
        return f"[{' '.join(map(_digits, x))}]"
    return x if isinstance(x, str) else f"{x:.3g}"


def _cut(text: str) -> str:
    words = " ".join(text.split()).replace("|", "/")
    return words if len(words) <= NOTICED else words[:NOTICED].rsplit(" ", 1)[0] + " …"


if __name__ == "__main__":
    main()
