"""Machines, by name or from their files."""

from __future__ import annotations

from pathlib import Path

from gcode.embedded import Stamp
from models.file import find_by_sha256
from models.file import load_machine as read_machine
from models.machine import Machine


def load_machine(machine: str | Path | Machine) -> Machine:
    """Load a machine by its name or from its file.

    Parameters
    ----------
    machine : a name of the library (`ffcomp machines list`), the path of a TOML file, or a machine already

    Returns
    -------
    Machine

    Raises
    ------
    MachineFileError, with every mistake in the file as a sentence

    Examples
    --------
    >>> ffcomp.load_machine("mp-delta-pro").limits.velocity_mm_per_s
    """
    return machine if isinstance(machine, Machine) else read_machine(str(machine))


def machine_of(stamp: Stamp, file: Path) -> Machine:
    """Find a stamp's machine: in the library, the user's folder, next to the print, or here.

    Raises MachineFileError if none of these files has the stamp's hash.
    """
    near = [path for folder in (file.parent, Path.cwd()) for path in sorted(folder.glob("*.toml"))]
    return read_machine(find_by_sha256(stamp.sha256, stamp.machine, near).resolve())
