"""Where compiled code is kept: numba finds its place beside our files or in the user's cache, and stops if both are
read-only, as for a service without a home. Then a folder for temporary files has to do. Before numba is imported.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def find_a_place() -> None:
    """See above; what the user has set stays."""
    places = (Path(__file__).parent / "__pycache__", user_cache() / "numba")
    if VARIABLE not in os.environ and not any(map(_writable, places)):
        os.environ[VARIABLE] = str(_temporary())


def user_cache() -> Path:
    """Where programmes keep what they can work out again."""
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home())
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))


def _writable(folder: Path) -> bool:
    """Whether it is there to write in, or can be made."""
    there = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _temporary() -> Path:
    """The same one next time, but only if nobody else can have put anything into it: code is loaded from there."""
    import tempfile

    user = getattr(os, "getuid", lambda: 0)()
    folder = Path(tempfile.gettempdir(), f"ffcomp-compiled-{user}")
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    own = stat.S_ISDIR(found.st_mode) and (os.name == "nt" or (found.st_uid == user and not found.st_mode & 0o077))
    return folder if own else Path(tempfile.mkdtemp(prefix="ffcomp-compiled-"))
