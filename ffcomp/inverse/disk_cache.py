"""On-disk cache of how a machine's possible printers differ, which takes a second on a delta.

A file's name is a hash of everything that determines its arrays: the machine, the settings and the source of the code
that computes them. So an entry is never out of date. Cache errors are never fatal: unreadable entries are misses,
failed writes are ignored.
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

from ffcomp.numerics.numba_cache import cache_folder

Arrays = Mapping[str, NDArray[Any]]

MOST = 24  # files; the least recently used are deleted
PACKAGES = ("ffcomp/inverse", "models")  # whose code computes the arrays


def name_of(*inputs: object) -> str:
    """Return the name of the cache file for results of these inputs."""
    return sha256(pickle.dumps(inputs) + _code()).hexdigest()[:32]


def load(name: str) -> Arrays:
    """Load the arrays of a file; an unreadable or missing file gives none."""
    file = cache_folder() / f"{name}.npz"
    try:
        with file.open("rb") as content, np.load(content, allow_pickle=False) as arrays:
            loaded = {each: arrays[each] for each in arrays.files}
        os.utime(file)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error):
        return {}
    return loaded


def save(name: str, arrays: Arrays) -> None:
    """Write the arrays, whole or not at all; a failure is ignored."""
    folder = cache_folder()
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


@cache
def _code() -> bytes:
    """Hash the code, and the library that determines its rounding."""
    root = Path(__file__).parents[2]
    known = sha256(np.__version__.encode())
    for package in PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            known.update(file.read_bytes())
    return known.digest()
