"""Whether a verb's numerical code has been compiled on this computer: a first run takes longer, and says why.

A verb that has ended well leaves an empty file in the user's cache, named for the installed code and its compiler.
"""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

from ffcomp.numerics.numba_cache import cache_folder

WARMED = ("compensate", "simulate")  # those that most people call first, and that `warmup` compiles, in about a minute
NEW_OBJECTS = 50_000  # after which garbage is collected
VERBS = (*WARMED, "compare", "diagnose", "fit")  # all that compile for more than some seconds


def first_run(verb: str) -> bool:
    """Return whether the verb is about to compile; False without a cache."""
    marker = _marker(verb)
    return marker is not None and not marker.exists()


def sentence(verb: str) -> str:
    """Say that the verb is about to compile."""
    if verb in WARMED:
        return "Compiling once, about a minute."
    return "Compiling once: this first run takes longer than the next ones."


def collect_rarely() -> None:
    """Collect garbage less often until the process ends: modules and compiled code stay in use anyway."""
    gc.set_threshold(NEW_OBJECTS, 50, 100)


def note_compiled(verb: str) -> None:
    """Remember that the verb has run, if the cache folder can be written."""
    if marker := _marker(verb):
        with suppress(OSError):
            marker.parent.mkdir(parents=True, exist_ok=True)
            marker.touch()


def _marker(verb: str) -> Path | None:
    from models.compiled import ahead

    folder = cache_folder()
    if ahead() or folder == Path(os.devnull):  # everything is compiled, or there is no cache
        return None
    code, compiler = Path(__file__), find_spec("numba")
    if compiler is None or compiler.origin is None:
        return None
    try:
        installed = [each.stat().st_mtime_ns for each in (code, Path(compiler.origin))]
    except OSError:
        return None
    known = (str(code), sys.version, installed)
    return folder / f"compiled-{verb}-{sha256(repr(known).encode()).hexdigest()[:16]}"
