"""`ffcomp machines diff`: what changed from one machine file to the next, and what it does to the vibrations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.cli.options import AsJson

if TYPE_CHECKING:
    from models.file import Difference

Old = Annotated[str, typer.Argument(metavar="OLD", help="A machine's name or the path of its file.")]
New = Annotated[str, typer.Argument(metavar="NEW", help="The machine to compare it with.")]


def diff_machines(old: Old, new: New, as_json: AsJson = False) -> None:
    """Show the parameters in which two machine files differ, and both sets of natural frequencies.

    Example: ffcomp machines diff my-delta.toml better.toml
    """
    from ffcomp.cli.common import exit_codes

    with exit_codes():
        from models.file import differences, entries, load_machine, mode_changes

        before, after = load_machine(old), load_machine(new)
        found = list(differences(entries(Path(before.path)), entries(Path(after.path))))
        frequencies = mode_changes(before, after).tolist()
        if as_json:
            _print_json(before.sha256, after.sha256, found, frequencies)
        else:
            _print(found, frequencies)


def _print_json(old: str, new: str, found: list[Difference], frequencies: list[list[float]]) -> None:
    from dataclasses import asdict

    from ffcomp.cli.common import print_json

    print_json(
        {
            "schema": "ffcomp-machine-diff/1",
            "old": {"sha256": old},
            "new": {"sha256": new},
            "changes": [asdict(each) for each in found],
            "frequencies_hz": [{"old": before, "new": after} for before, after in frequencies],
        }
    )


def _print(found: list[Difference], frequencies: list[list[float]]) -> None:
    if not found:
        print("The two files describe the same machine.")
        return
    for each in found:
        change = ", ".join(f"{relative:+.1%}" for relative in each.relative)
        note = f"  # {each.provenance}" if each.provenance not in ("", "default") else ""
        print(
            f"{each.key}: {_shown(each.old)} → {_shown(each.new)} {each.unit}{f' ({change})' if change else ''}{note}"
        )
    print("natural frequencies at 0, 0, Hz:", ", ".join(f"{before:.1f} → {after:.1f}" for before, after in frequencies))


def _shown(value: object) -> str:
    return "nothing" if value is None else str(value)
