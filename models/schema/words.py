"""Units that keys end in, and the nearest known word to a mistaken one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

UNITS = {  # endings of keys; a longer one goes before one it ends in
    "_n_s_per_m": "N s/m",
    "_mm_per_s2": "mm/s²",
    "_mm_per_s": "mm/s",
    "_n_per_m": "N/m",
    "_per_mm": "1/mm",
    "_per_s2": "1/s²",
    "_per_s": "1/s",
    "_deg": "degrees",
    "_mm": "mm",
    "_kg": "kg",
    "_hz": "Hz",
}


def unit_of(key: str) -> str:
    """Return the unit a key's name ends in, '' if none."""
    return next((unit for ending, unit in UNITS.items() if key.endswith(ending)), "")


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """' Did you mean …?' or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" Did you mean {close[0]!r}?" if close else ""
