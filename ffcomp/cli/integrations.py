"""`ffcomp integrations`: how slicers and hosts use ffcomp, with the lines to paste and the wrappers to install."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ffcomp.cli.command import group, verb
from ffcomp.cli.common import say
from ffcomp.errors import RequestError
from ffcomp.request import MACHINE, OUTPUT, Argument, Option, Request

if TYPE_CHECKING:
    from ffcomp.integrations.recipes import Recipe


@verb
def list_integrations() -> None:
    """List the slicers and hosts that can use ffcomp."""
    from ffcomp.integrations.recipes import RECIPES

    width = max(map(len, RECIPES))
    for recipe in RECIPES.values():
        print(f"{recipe.name:{width}}  {recipe.about}")


@dataclass(frozen=True)
class IntegrationRequest(Request):
    """A slicer or a host, and the machine that it prints on."""

    name: Annotated[str, Argument("A slicer or a host; see: ffcomp integrations list.", metavar="NAME")]
    machine: Annotated[
        str, Option("Machine to write into it.", MACHINE, "--machine -m", metavar="NAME", env="FFCOMP_MACHINE")
    ] = "my-delta"


@verb
def show_integration(request: IntegrationRequest) -> None:
    """Show how to set it up, with the line to paste.

    Example: ffcomp integrations show prusaslicer --machine my-delta
    """
    from ffcomp.integrations.recipes import executable, instructions

    print(instructions(_recipe(request.name), _anywhere(request.machine), executable()))


@dataclass(frozen=True)
class InstallRequest(IntegrationRequest):
    """A wrapper to be installed."""

    to: Annotated[
        Path | None,
        Option("Folder of the wrapper. Default: the folder that the program searches.", OUTPUT, metavar="DIR"),
    ] = None


@verb
def install_integration(request: InstallRequest) -> None:
    """Install the wrapper where the program searches for it."""
    from ffcomp.integrations.recipes import executable, instructions, wrapper
    from gcode.atomic_write import replace_atomically

    recipe, machine = _recipe(request.name), _anywhere(request.machine)
    if not recipe.wrapper:
        raise RequestError(f"{request.name} needs no wrapper; see: ffcomp integrations show {request.name}")
    folder = request.to or next(iter(recipe.folders()), None)
    if folder is None:
        raise RequestError(f"No folder of {recipe.name} was found here; name it with --to DIR.")
    target = folder / recipe.installed_as
    target.parent.mkdir(parents=True, exist_ok=True)
    replace_atomically(target, [wrapper(recipe, machine, executable()).encode()])
    print(target)
    say(f"\n{instructions(recipe, machine, executable())}")


def _anywhere(machine: str) -> str:
    """Return a machine file's full path, for slicers and hosts start ffcomp in folders of their own; keep a name."""
    return str(Path(machine).resolve()) if machine.endswith(".toml") or Path(machine).is_file() else machine


def _recipe(name: str) -> Recipe:
    from ffcomp.integrations.recipes import RECIPES

    if name.lower() not in RECIPES:
        raise RequestError(f"{name}: not one of {', '.join(RECIPES)}.")
    return RECIPES[name.lower()]


integrations = group(
    "integrations",
    "Use ffcomp from your slicer or your printer's host.",
    list_integrations,
    show_integration,
    install_integration,
)
