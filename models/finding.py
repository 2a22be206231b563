"""Named machine files and their entries for a list; quick to import, unlike the reader."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import platformdirs

LIBRARY = Path(__file__).parent / "library"


def user_folder() -> Path:
    """Where the user's own machine files live."""
    return Path(platformdirs.user_config_dir("ffcomp")) / "machines"


def machine_paths() -> dict[str, Path]:
    """Every named machine, in alphabetical order."""
    paths = {path.stem: path for folder in (LIBRARY, user_folder()) for path in folder.glob("*.toml")}
    return dict(sorted(paths.items()))


@dataclass(frozen=True, slots=True)
class NamedMachine:
    """One line of a list of machines; None: not in the file."""

    name: str
    origin: str  # library or user
    path: Path
    kinematics: str | None
    printer: str | None


def named_machines() -> list[NamedMachine]:
    """List every named machine, in alphabetical order."""
    found = []
    for name, path in machine_paths().items():
        changed = path.stat().st_mtime_ns if path.exists() else 0  # removed in the meantime
        origin = "library" if path.parent == LIBRARY else "user"
        found.append(NamedMachine(name, origin, path, *_glanced(path, changed)))
    return found


@lru_cache(maxsize=512)
def _glanced(path: Path, changed: int) -> tuple[str | None, str | None]:
    """Return `kinematics.type` and `name` of a machine file, unchecked; None if missing.

    A file is read once after each change: the page of `ffcomp serve` polls every second.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return None, None
    kinematics = document.get("kinematics")
    said = kinematics.get("type") if isinstance(kinematics, dict) else None, document.get("name")
    kind, name = (value if isinstance(value, str) else None for value in said)
    return kind, name
