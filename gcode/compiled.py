"""How numerical loops are compiled: all alike, since the compiler compiles its own functions for every set of options.

A literal number as an argument, another memory layout of an array, or one array assigned to a row of another one each
cost half a second and more of every user's first run (docs/decisions/0010-compile-on-the-first-run.md).
"""

from __future__ import annotations

from typing import Any

from numba import njit

_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
kernel = njit(**_OPTIONS)
