"""Hidden printers to try a method of diagnosis on, and the score of its answers.

    python -m validation.blind make -o bank/ --cases 24
    python -m validation.blind score bank/ answers.json

First `make`; then let the method look at each folder of cases/ and nothing else; then `score` with its answers.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ffcomp.errors import INPUT_ERRORS, explain
from ffcomp.numerics.serialise import json_line
from validation.blind.bank import make_bank, score_bank
from validation.blind.kinds import MACHINES

LONGEST_S, SHORTEST_S = 10.0, 0.8
"""Durations that a run may have."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: those of `ffcomp`."""
    options = _parser().parse_args(arguments)
    try:
        options.run(options)
    except INPUT_ERRORS as error:
        sentence, code = explain(error)
        print(f"blind: {sentence}", file=sys.stderr)
        return code
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m validation.blind", description=(__doc__ or "").split("\n")[0])
    verbs = parser.add_subparsers(required=True)
    make = verbs.add_parser("make", help="a machine file and measured runs for each, and its truth under seal")
    make.set_defaults(run=_make)
    make.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the bank")
    make.add_argument("--cases", type=_at_least(1), default=24, metavar="N", help="a larger bank goes on")
    make.add_argument("--machine", action="append", choices=list(MACHINES), help="of this kind only; may be repeated")
    make.add_argument("--seed", type=_at_least(0), default=1, metavar="N", help="another number, another bank")
    make.add_argument("--seconds", type=_duration, default=2.0, metavar="S", help="duration of a run")
    make.add_argument("-q", "--quiet", action="store_true", help="no progress")
    score = verbs.add_parser("score", help="rates with Wilson's 95 %% intervals, by stratum, and every miss")
    score.set_defaults(run=_score)
    score.add_argument("bank", type=Path, help="folder that make has written")
    score.add_argument("answers", type=Path, help="a JSON file, or a folder of what ffcomp diagnose --json says")
    score.add_argument("--partial", action="store_true", help="score the answered cases where others are not")
    for each in (make, score):
        each.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _at_least(least: int) -> Any:
    def count(text: str) -> int:
        if int(text) < least:
            raise argparse.ArgumentTypeError(f"must be at least {least}, and is {text}")
        return int(text)

    return count


def _duration(text: str) -> float:
    if not SHORTEST_S <= float(text) <= LONGEST_S:
        raise argparse.ArgumentTypeError(f"must be {SHORTEST_S:g} to {LONGEST_S:g} s, and is {text}")
    return float(text)


def _make(options: argparse.Namespace) -> None:
    def progress(text: str) -> None:
        if not options.quiet:
            print(text, file=sys.stderr)

    folder, machines = options.output, options.machine or list(MACHINES)
    names = make_bank(folder, options.cases, options.seed, options.seconds, machines, progress)
    if options.json:
        folders = [str(folder / "cases" / name) for name in names]
        print(json_line({"schema": "ffcomp-bank/1", "folder": str(folder), "cases": names, "folders": folders}))
    else:
        print(f"{len(names)} cases in {folder / 'cases'}; their labels are sealed in {folder / 'sealed'}.")
        print(f"Then: ffcomp diagnose {folder}/cases/NAME/runs/*.csv -m {folder}/cases/NAME/machine.toml --json")


def _score(options: argparse.Namespace) -> None:
    result = score_bank(options.bank, options.answers, options.partial)
    if options.json:
        print(json_line(result))
        return
    print(f"{result['cases']} cases" + (f", {result['unanswered']} not answered" if result["unanswered"] else ""))
    for rate in result["rates"]:
        if rate["total"]:
            print(f"  {rate['title']}: {_share(rate)}; aim {rate['aim']}: {rate['verdict']}")
    print("As it should be, by stratum:")
    for stratum in result["strata"]:
        if stratum["total"]:
            print(f"  {stratum['name']:<12} {_share(stratum)}")
    for miss in result["misses"]:
        why = f" ({miss['because']})" if miss["because"] else ""
        print(f"  {miss['case']} {miss['stratum']}: hidden {miss['hidden']}, said {miss['said']}{why}")


def _share(counts: dict[str, Any]) -> str:
    low, high = 100 * counts["low"], 100 * counts["high"]
    return f"{counts['hits']} of {counts['total']}, 95 % interval {low:.0f}-{high:.0f} %"


if __name__ == "__main__":
    raise SystemExit(main())
