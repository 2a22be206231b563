"""Choose the folders of numba's compiled code and of ffcomp's own cache.

Numba caches beside our files or in the user's cache, and fails if both are read-only, as for a service without a home.
Then a temporary folder serves. This must happen before numba is imported.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
OUR_VARIABLE = "FFCOMP_CACHE"  # another folder for what ffcomp itself keeps; `off`: no cache


def ensure_cache_folder() -> None:
    """Set numba's cache folder where it would find none; a folder that the user has set stays."""
    places = (Path(__file__).parent / "__pycache__", user_cache() / "numba")
    if VARIABLE not in os.environ and not any(map(_writable, places)):
        os.environ[VARIABLE] = str(_temporary())


def user_cache() -> Path:
    """Return the user's cache folder."""
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home())
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))


def cache_folder() -> Path:
    """Return the folder of ffcomp's own cache, which need not exist; without a cache no folder can be made there."""
    folder = os.environ.get(OUR_VARIABLE, "")
    return Path(os.devnull) if folder == "off" else Path(folder) if folder else user_cache() / "ffcomp"


def _writable(folder: Path) -> bool:
    """Return whether the folder exists and is writable, or can be made."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _temporary() -> Path:
    """Return a folder that is the same next time and that nobody else can write to: code is loaded from it."""
    import tempfile

    user = getattr(os, "getuid", lambda: 0)()
    folder = Path(tempfile.gettempdir(), f"ffcomp-compiled-{user}")
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    own = stat.S_ISDIR(found.st_mode) and (os.name == "nt" or (found.st_uid == user and not found.st_mode & 0o077))
    return folder if own else Path(tempfile.mkdtemp(prefix="ffcomp-compiled-"))
