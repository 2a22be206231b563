"""Choose the folders of numba's compiled code and of ffcomp's own cache.

Numba caches next to our files or in the user's cache, and fails if both are read-only, as for a service without a home.
Then a temporary folder serves. This must happen before numba is imported.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

from platformdirs import user_cache_path

VARIABLE = "NUMBA_CACHE_DIR"
OUR_VARIABLE = "FFCOMP_CACHE"  # another folder for what ffcomp itself keeps; `off`: no cache


def ensure_cache_folder() -> None:
    """Set numba's cache folder where it would find none; a folder that the user has set stays."""
    places = (Path(__file__).parent / "__pycache__", user_cache_path("numba", appauthor=False))
    if VARIABLE not in os.environ and not any(map(_writable, places)):
        os.environ[VARIABLE] = str(_temporary())


def cache_folder() -> Path:
    """Return the folder of ffcomp's own cache, which need not exist; without a cache no folder can be made there."""
    if folder := os.environ.get(OUR_VARIABLE, ""):
        return Path(os.devnull if folder == "off" else folder)
    return user_cache_path("ffcomp", appauthor=False, opinion=False)


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
    status = folder.lstat()
    private = os.name == "nt" or (status.st_uid == user and not status.st_mode & 0o077)
    return folder if stat.S_ISDIR(status.st_mode) and private else Path(tempfile.mkdtemp(prefix="ffcomp-compiled-"))
