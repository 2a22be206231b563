"""`ffcomp bank`: hidden printers to try a method of diagnosis on, and the score of its answers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ffcomp.cli.help import ACCURACY, MACHINE, OUTPUT, Command, Group
from ffcomp.cli.options import AsJson, Quiet

app = typer.Typer(
    cls=Group,
    no_args_is_help=True,
    help="Try a method of diagnosis on printers that hide something, and score its answers.\n\n"
    "First ffcomp bank make, then let the method look at each folder of cases/ and nothing else, then ffcomp bank "
    "score with its answers.",
)

Machines = Annotated[
    list[str] | None,
    typer.Option(
        "--machine",
        metavar="KIND",
        rich_help_panel=MACHINE,
        help="Of this kind only: delta, nozzle (a delta with one chip on its nozzle), cartesian, corexy or axis "
        "(driven by a position, or by a force). May be repeated.",
    ),
]
Cases = Annotated[
    int, typer.Option("--cases", metavar="N", rich_help_panel=ACCURACY, min=1, help="How many. A larger bank goes on.")
]
Seed = Annotated[int, typer.Option(metavar="N", rich_help_panel=ACCURACY, min=0, help="Another number, another bank.")]
Seconds = Annotated[
    float, typer.Option(metavar="S", rich_help_panel=ACCURACY, min=0.8, max=10.0, help="Duration of a run.")
]
Folder = Annotated[
    Path, typer.Option("--output", "-o", metavar="DIR", rich_help_panel=OUTPUT, help="Folder of the bank.")
]
Bank = Annotated[Path, typer.Argument(metavar="DIR", help="Folder that ffcomp bank make has written.")]
Answers = Annotated[
    Path,
    typer.Argument(
        metavar="ANSWERS", help="A JSON file of all answers, or a folder with what ffcomp diagnose --json says of each."
    ),
]
Partial = Annotated[
    bool, typer.Option("--partial", rich_help_panel=ACCURACY, help="Score the answered cases where others are not.")
]


@app.command("make", cls=Command)
def make(
    output: Folder,
    cases: Cases = 24,
    machine: Machines = None,
    seed: Seed = 1,
    seconds: Seconds = 2.0,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Make hidden printers: a machine file and measured runs for each, and its truth under seal.

    Half of the cases hide one effect of the catalogue, and a sixth each two, nothing, and something that no effect is
    meant for; any beginning of the bank is balanced. cases/NAME/ is all that a method may see. sealed/ holds the
    labels, and fresh runs; seals/ their hashes. Cases that are there are kept.

    Example: ffcomp bank make -o bank/ --cases 24
    """
    from ffcomp.cli.common import exit_codes, print_json, say
    from ffcomp.cli.options import check_choice

    with exit_codes():
        from ffcomp.bank.kinds import MACHINES
        from ffcomp.bank.make import make_bank

        for each in machine or []:
            check_choice("--machine", each, tuple(MACHINES))
        names = make_bank(output, cases, seed, seconds, machine or list(MACHINES), lambda text: say(text, quiet))
        if as_json:
            folders = [str(output / "cases" / name) for name in names]
            print_json({"schema": "ffcomp-bank/1", "folder": str(output), "cases": names, "folders": folders})
        else:
            print(f"{len(names)} cases in {output / 'cases'}; their labels are sealed in {output / 'sealed'}.")
            print(f"Then: ffcomp diagnose {output}/cases/NAME/runs/*.csv -m {output}/cases/NAME/machine.toml --json")


@app.command("score", cls=Command)
def score(bank: Bank, answers: Answers, partial: Partial = False, as_json: AsJson = False) -> None:
    """Score answers against the sealed labels: rates with Wilson's 95 % intervals, by stratum, and every miss.

    The file of answers is {"schema": "ffcomp-bank-answers/1", "answers": {"case-…": {"verdict": "effects", "effects":
    ["cogging"]}, …}}, with the verdict effects, none or unknown. An effect may be {"name": …, "parameters": {KEY:
    {"value", "low", "high"}}}; then its numbers and intervals are scored too.

    Example: ffcomp bank score bank/ answers.json
    """
    from ffcomp.cli.common import exit_codes, print_json

    with exit_codes():
        from ffcomp.bank.make import score_bank

        found = score_bank(bank, answers, partial)
        if as_json:
            print_json(found)
        else:
            _print(found)


def _print(found: dict[str, Any]) -> None:
    print(f"{found['cases']} cases" + (f", {found['unanswered']} not answered" if found["unanswered"] else ""))
    for rate in found["rates"]:
        if rate["total"]:
            print(f"  {rate['title']}: {_share(rate)}; aim {rate['aim']}: {rate['verdict']}")
    print("As it should be, by stratum:")
    for each in found["strata"]:
        if each["total"]:
            print(f"  {each['name']:<12} {_share(each)}")
    for each in found["misses"]:
        why = f" ({each['because']})" if each["because"] else ""
        print(f"  {each['case']} {each['stratum']}: hidden {each['hidden']}, said {each['said']}{why}")


def _share(each: dict[str, Any]) -> str:
    return f"{each['hits']} of {each['total']}, 95 % interval {100 * each['low']:.0f}-{100 * each['high']:.0f} %"
