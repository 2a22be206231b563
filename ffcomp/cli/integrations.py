"""`ffcomp integrations`: how slicers and hosts use ffcomp, with the lines to paste and the wrappers to install."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.request import MACHINE, OUTPUT

if TYPE_CHECKING:
    from ffcomp.integrations.recipes import Recipe

app = typer.Typer(help="Use ffcomp from your slicer or your printer's host.", no_args_is_help=True)

Name = Annotated[str, typer.Argument(metavar="NAME", help="A slicer or a host; see: ffcomp integrations list.")]
MachineName = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        metavar="NAME",
        envvar="FFCOMP_MACHINE",
        rich_help_panel=MACHINE,
        help="Machine that is written into it.",
    ),
]
Folder = Annotated[
    Path | None,
    typer.Option(
        "--to",
        metavar="DIR",
        rich_help_panel=OUTPUT,
        help="Folder of the wrapper. Default: the folder that the program searches.",
    ),
]


@app.command("list")
def list_integrations() -> None:
    """List the slicers and hosts that can use ffcomp."""
    from ffcomp.integrations.recipes import RECIPES

    width = max(map(len, RECIPES))
    for recipe in RECIPES.values():
        print(f"{recipe.name:{width}}  {recipe.about}")


@app.command("show")
def show_integration(name: Name, machine: MachineName = "my-delta") -> None:
    """Show how to set it up, with the line to paste.

    Example: ffcomp integrations show prusaslicer --machine my-delta
    """
    from ffcomp.integrations.recipes import executable, instructions

    print(instructions(_recipe(name), _anywhere(machine), executable()))


@app.command("install")
def install_integration(name: Name, machine: MachineName = "", to: Folder = None) -> None:
    """Install the wrapper where the program searches for it."""
    from ffcomp.cli.common import exit_codes, say
    from ffcomp.integrations.recipes import executable, instructions, wrapper
    from gcode.atomic_write import replace_atomically

    recipe, machine = _recipe(name), _anywhere(machine)
    if not recipe.wrapper:
        raise typer.BadParameter(f"{name} needs no wrapper; see: ffcomp integrations show {name}")
    with exit_codes():
        target = _folder(recipe, to) / recipe.installed_as
        target.parent.mkdir(parents=True, exist_ok=True)
        replace_atomically(target, [wrapper(recipe, machine, executable()).encode()])
    print(target)
    say(f"\n{instructions(recipe, machine or 'my-delta', executable())}")


def _anywhere(machine: str) -> str:
    """Return a machine file's full path, for slicers and hosts start ffcomp in folders of their own; keep a name."""
    return str(Path(machine).resolve()) if machine.endswith(".toml") or Path(machine).is_file() else machine


def _recipe(name: str) -> Recipe:
    from ffcomp.integrations.recipes import RECIPES

    if name.lower() not in RECIPES:
        raise typer.BadParameter(f"{name}: not one of {', '.join(RECIPES)}.")
    return RECIPES[name.lower()]


def _folder(recipe: Recipe, asked: Path | None) -> Path:
    if asked is not None:
        return asked
    found = recipe.folders()
    if not found:
        raise typer.BadParameter(f"No folder of {recipe.name} was found here; name it with --to DIR.")
    return found[0]
