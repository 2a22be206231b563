"""Machines, by name or from their files."""

from __future__ import annotations

from pathlib import Path

from models.file import load_machine as read_machine
from models.file import load_plant as read_plant
from models.machine import Machine


def load_machine(machine: str | Path | Machine) -> Machine:
    """Load a machine by its name or from its file.

    Parameters
    ----------
    machine : a name of the library (`ffcomp machines list`), the path of a TOML file, or a machine already

    Raises
    ------
    models.errors.MachineFileError
        If the file cannot be read, with every mistake in it as a sentence.
    """
    return machine if isinstance(machine, Machine) else read_machine(str(machine))


def load_plant(machine: str | Path | Machine) -> Machine:
    """Load a printer or one axis by itself, as `load_machine` does."""
    return read_plant(str(machine)) if isinstance(machine, str | Path) else machine
