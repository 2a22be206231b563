"""Hidden printers to try a method of diagnosis on, and the score of its answers.

    python -m validation.blind make bank/ --cases 24
    python -m validation.blind score bank/

First `make`; then let the method look at each folder of cases/ and nothing else, and write verdicts/NAME.json; then
`score`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ffcomp.errors import INPUT_ERRORS, explain
from validation.blind.bank import cases_of, full_bank, judged_cases, label_path, make_case, same_bank
from validation.blind.kinds import MACHINES
from validation.blind.score import Rate, as_wanted, miss, rates


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: those of `ffcomp`."""
    parser = argparse.ArgumentParser(prog="python -m validation.blind", description=(__doc__ or "").split("\n")[0])
    verbs = parser.add_subparsers(required=True)
    make = verbs.add_parser("make", help="a machine file and measured runs for each, and its truth under seal")
    make.set_defaults(run=_make)
    make.add_argument("--cases", type=int, default=24, metavar="N", help="a larger bank goes on")
    make.add_argument("--machine", action="append", choices=list(MACHINES), help="of this kind only; may be repeated")
    make.add_argument("--seed", type=int, default=1, metavar="N", help="another number, another bank")
    make.add_argument("--seconds", type=float, default=2.0, metavar="S", help="duration of a run, 0.8 to 10")
    score = verbs.add_parser("score", help="rates with Wilson's 95 %% intervals, and every miss")
    score.set_defaults(run=_score)
    for each in (make, score):
        each.add_argument("bank", type=Path, help="folder of the bank")
    options = parser.parse_args(arguments)
    try:
        options.run(options)
    except INPUT_ERRORS as error:
        sentence, code = explain(error)
        print(f"blind: {sentence}", file=sys.stderr)
        return code
    return 0


def _make(options: argparse.Namespace) -> None:
    bank, machines = options.bank, options.machine or list(MACHINES)
    same_bank(bank, options.seconds)
    for name, (seed, stratum) in full_bank(options.cases, options.seed, machines).items():
        if not label_path(bank, name).exists():
            print(f"{name}: {make_case(bank, name, seed, stratum, options.seconds) or 'made'}", file=sys.stderr)
    print(f"{len(cases_of(bank))} cases in {bank / 'cases'}; their labels are sealed in {bank / 'sealed'}.")
    print(f"Then: ffcomp diagnose {bank}/cases/NAME/runs/*.csv -m {bank}/cases/NAME/machine.toml --json")


def _score(options: argparse.Namespace) -> None:
    judged = judged_cases(options.bank, cases_of(options.bank))
    wanted = sum(as_wanted(j) for j in judged)
    for rate in [Rate("as it should be", wanted, len(judged), "", lambda _: True), *rates(judged)]:
        if rate.total:
            low, high = (100 * end for end in rate.interval)
            aim = f"; aim {rate.aim}: {rate.verdict}" if rate.aim else ""
            print(f"{rate.title}: {rate.hits} of {rate.total}, 95 % interval {low:.0f}-{high:.0f} %{aim}")
    for found in (miss(j) for j in judged if not as_wanted(j)):
        why = f" ({found['because']})" if found["because"] else ""
        print(f"{found['case']} {found['stratum']}: hidden {found['hidden']}, said {found['said']}{why}")


if __name__ == "__main__":
    raise SystemExit(main())
