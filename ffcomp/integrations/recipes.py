"""How to use ffcomp from each slicer and host, and where their wrappers go."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
DEFAULTS = {"EXECUTABLE": "ffcomp", "MACHINE": ""}  # as the wrappers have them
CLASSIC = """\
The slicer adds the file's path. It runs when you export or send, not when you slice; the preview and a project file
keep showing the original. If ffcomp fails the export fails: the print is never sent uncompensated."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """A slicer or a host."""

    name: str
    about: str
    steps: str  # with places for what `instructions` fills in
    wrapper: str = ""  # a file in this folder; empty: none is needed
    installed_as: str = ""
    folders: Callable[[], list[Path]] = list  # that are there, the likeliest first


def executable() -> str:
    """Return the full path of the running program: slicers started from an icon do not know the shell's PATH."""
    name = sys.argv[0] if Path(sys.argv[0]).stem == "ffcomp" else "ffcomp"
    path = shutil.which(name)
    return os.path.abspath(path) if path else "ffcomp"


def joined(arguments: Sequence[str]) -> str:
    """Join a command line, quoted as this platform wants it."""
    return subprocess.list2cmdline(arguments) if sys.platform == "win32" else shlex.join(arguments)


def instructions(recipe: Recipe, machine: str, program: str) -> str:
    """Return the steps to take, with this machine and this program."""
    line = joined([program, "compensate", "--machine", machine])
    return recipe.steps.format(line=line, machine=machine, quoted=joined([machine]), classic=CLASSIC)


def wrapper(recipe: Recipe, machine: str, program: str) -> str:
    """Return the wrapper's text with this program, and this machine if one is named."""
    text = (HERE / recipe.wrapper).read_text(encoding="utf-8")
    for name, value in (("EXECUTABLE", program), ("MACHINE", machine)):
        default = f"\n{name} = {json.dumps(DEFAULTS[name])}\n"
        text = text.replace(default, f"\n{name} = {json.dumps(value)}\n")
    return text


def cura_folders() -> list[Path]:
    """Where each installed version of Cura looks for scripts, the newest first."""
    import platformdirs

    versions = Path(platformdirs.user_data_dir("cura", appauthor=False, roaming=True)).glob("[0-9]*.[0-9]*")
    return [folder / "scripts" for folder in sorted(versions, key=_version, reverse=True)]


def _version(folder: Path) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", folder.name)]


def moonraker_folders() -> list[Path]:
    """Moonraker's components, where its installer and KIAUH put them."""
    components = Path.home() / "moonraker" / "moonraker" / "components"
    return [components] if components.is_dir() else []


RECIPES = {
    recipe.name: recipe
    for recipe in (
        Recipe(
            "prusaslicer",
            "PrusaSlicer and SuperSlicer: a post-processing script",
            """\
Print Settings > Output options > Post-processing scripts (mode: Expert), one line, the last one:

{line}

{classic}""",
        ),
        Recipe(
            "orcaslicer",
            "OrcaSlicer: a post-processing script",
            """\
Process settings > Others > Post-processing Scripts (mode: Advanced), one line, the last one:

{line}

{classic}""",
        ),
        Recipe(
            "bambustudio",
            "BambuStudio: a post-processing script",
            """\
Process settings > Others > Post-processing Scripts (mode: Advanced), one line, the last one:

{line}

{classic}

For Bambu Lab's own printers it runs when you slice, and the preview shows the result.""",
        ),
        Recipe(
            "cura",
            "Cura 4 and 5: a post-processing script within Cura",
            """\
ffcomp integrations install cura --machine {quoted}

It puts Ffcomp.py into Cura's scripts folder. Restart Cura; then Extensions > Post Processing > Modify G-Code > Add a
script > ffcomp: compensate vibration, the last in the list. It runs when you save or send, and Cura waits for it.
If it fails, Cura shows a message, and the second line of the print states that it is NOT compensated.""",
            "cura_script.py",
            "Ffcomp.py",
            cura_folders,
        ),
        Recipe(
            "simplify3d",
            "Simplify3D: a terminal command",
            """\
Process settings > Scripts > Additional terminal commands for post processing (version 4), or Post Processing
(version 5):

{line} "[output_filepath]"

Simplify3D does not look at exit codes: look for "; Processed by ffcomp" in the file's second line.""",
        ),
        Recipe(
            "moonraker",
            "Moonraker (Mainsail, Fluidd): every uploaded print, on the printer's computer",
            """\
On the printer's computer: ffcomp integrations install moonraker
It puts ffcomp.py among Moonraker's components. In moonraker.conf:

[ffcomp]
machine: {machine}

Restart Moonraker. A compensated print has "ffcomp" among file_processors of its metadata. One that could not be
compensated is unchanged and can be printed; moonraker.log has the reason. The better place is the slicer: it is
faster there, and a failure stops the print from being sent.""",
            "moonraker_component.py",
            "ffcomp.py",
            moonraker_folders,
        ),
        Recipe(
            "octoprint",
            "OctoPrint: nothing to install; let the slicer do it",
            """\
OctoPrint prints what it is given. Let the slicer compensate before it uploads (ffcomp integrations show prusaslicer),
or do it by hand before you upload:

{line} print.gcode

OctoPrint's estimate and the progress of M73 follow the file, which says its new time.""",
        ),
        Recipe(
            "shell",
            "Any other slicer, or by hand",
            """\
{line} print.gcode

The file is changed in place; -o FILE leaves it. Exit code 0: done, or done before; else the file is unchanged.""",
        ),
    )
}
