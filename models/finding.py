"""The machine files that have a name, and what a list says of them; light to import, unlike reading one."""

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
    """Every machine that can be asked for by name, in alphabetical order."""
    paths = {path.stem: path for folder in (LIBRARY, user_folder()) for path in folder.glob("*.toml")}
    return dict(sorted(paths.items()))


@dataclass(frozen=True, slots=True)
class NamedMachine:
    """What a list says of a machine; None: its file does not."""

    name: str
    origin: str  # library or user
    path: Path
    kinematics: str | None
    printer: str | None


def named_machines() -> list[NamedMachine]:
    """Return every machine that has a name, in alphabetical order."""
    return [
        NamedMachine(name, "library" if path.parent == LIBRARY else "user", path, *_glanced(path, _changed(path)))
        for name, path in machine_paths().items()
    ]


@lru_cache(maxsize=512)
def _glanced(path: Path, changed: int) -> tuple[str | None, str | None]:
    """Read a file once for each time that it was changed: the page of `ffcomp serve` asks every second."""
    return glance(path)


def _changed(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:  # removed meanwhile
        return 0


def glance(path: Path) -> tuple[str | None, str | None]:
    """Return what a list needs of a machine file, its `kinematics.type` and `name`, unchecked; None if not there."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return None, None
    kinematics = document.get("kinematics")
    kind = kinematics.get("type") if isinstance(kinematics, dict) else None
    return _text(kind), _text(document.get("name"))


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None
