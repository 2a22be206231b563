"""What is worked out once for a machine, kept in the user's cache for the next time.

A file's name is a hash of all that its numbers follow from: the machine, what was asked for, and the source of the code
that works them out. So nothing in it is ever out of date: it is there, or it is worked out anew. Nobody waits for the
cache and nothing fails for it: a file that cannot be read is not there, one that cannot be written is not kept.
"""

from __future__ import annotations

import os
import pickle
import zlib
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from ffcomp.numerics.numba_cache import user_cache

Arrays = Mapping[str, NDArray[Any]]

VARIABLE = "FFCOMP_CACHE"  # another folder; `off`: nothing is kept
MOST = 24  # files; those used longest ago go
PACKAGES = ("ffcomp/inverse", "models")  # whose code the numbers come of


def name_of(*given: object) -> str:
    """A file's name for numbers that follow from what is given."""
    return sha256(pickle.dumps(given) + _code()).hexdigest()[:32]


def load(name: str) -> Arrays:
    """The arrays of a file, or none."""
    file = _folder() / f"{name}.npz"
    try:
        with file.open("rb") as content, np.load(content, allow_pickle=False) as arrays:
            found = {each: arrays[each] for each in arrays.files}
        os.utime(file)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error):
        return {}
    return found


def save(name: str, arrays: Arrays) -> None:
    """Keep them, whole or not at all."""
    folder = _folder()
    draft = folder / f".{name}.{os.getpid()}.npz"
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            np.savez(draft, **dict(arrays))  # type: ignore[arg-type]
            draft.replace(folder / f"{name}.npz")
        finally:
            draft.unlink(missing_ok=True)
        by_use = sorted(folder.glob("[!.]*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
        for file in by_use[MOST:]:
            file.unlink(missing_ok=True)


def _folder() -> Path:
    said = os.environ.get(VARIABLE, "")
    return Path(os.devnull) if said == "off" else Path(said) if said else user_cache() / "ffcomp"


@cache
def _code() -> bytes:
    """A hash of the code, and of the library whose rounding it has."""
    root = Path(__file__).parents[2]
    known = sha256(np.__version__.encode())
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            known.update(file.read_bytes())
    return known.digest()
