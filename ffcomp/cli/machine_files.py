"""Find the machine file that a print was compensated with, also where only its path was given."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gcode.embedded import Stamp
    from models.machine import Machine

MOST = 50  # paths that are remembered, the last ones


def remember(machine: Machine) -> None:
    """Keep the path of a machine file that has no name, for `machine_of`; a failure is ignored."""
    from models.file import machine_paths

    path = Path(machine.path).resolve()
    if path in {known.resolve() for known in machine_paths().values()}:
        return
    paths = [*(each for each in _remembered() if each != path), path][-MOST:]
    list_of_paths = _list()
    with suppress(OSError, UnicodeError):
        list_of_paths.parent.mkdir(parents=True, exist_ok=True)
        list_of_paths.write_text("".join(f"{each}\n" for each in paths), encoding="utf-8")


def machine_of(stamp: Stamp, file: Path) -> Machine:
    """Find a stamp's machine: in the library, the user's folder, next to the print, here, or among those used before.

    Raises
    ------
    MachineFileError
        If none of these files has the stamp's hash.
    """
    from models.file import find_by_sha256, load_machine

    near = [path for folder in (file.parent, Path.cwd()) for path in sorted(folder.glob("*.toml"))]
    return load_machine(find_by_sha256(stamp.sha256, stamp.machine, [*near, *reversed(_remembered())]).resolve())


def _remembered() -> list[Path]:
    try:
        return [Path(line) for line in _list().read_text(encoding="utf-8").splitlines() if line]
    except (OSError, UnicodeError):
        return []


def _list() -> Path:
    from ffcomp.numerics.numba_cache import cache_folder

    return cache_folder() / "machine_files.txt"
