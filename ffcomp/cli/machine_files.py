"""Find the machine file that a print was compensated with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gcode.embedded import Stamp
    from models.machine import Machine


def machine_of(stamp: Stamp, file: Path) -> Machine:
    """Find a stamp's machine: in the library, the user's folder, next to the print, or here.

    Raises
    ------
    MachineFileError
        If none of these files has the stamp's hash.
    """
    from models.file import find_by_sha256, load_machine

    near = [path for folder in (file.parent, Path.cwd()) for path in sorted(folder.glob("*.toml"))]
    return load_machine(find_by_sha256(stamp.sha256, stamp.machine, near).resolve())
