"""Compile the kernels, and tell when their cached code is out of date."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

SOURCES = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))).hexdigest()


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a kernel and cache it on disk until any file of this folder changes.

    Numba compares its cache with the function's own file only, and would go on with the old code of what the function
    calls in the others.
    """
    kernel = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})(function)
    cache = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if cache is not None:  # without the compiler, or without a place to write to, there is none
        cache._source_stamp = SOURCES
    return kernel


# Functions called in a loop over lanes have to be inlined, or the loop is not vectorised.
inlined = njit(error_model="numpy", nogil=True, fastmath={"contract"}, forceinline=True)
