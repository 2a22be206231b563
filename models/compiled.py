"""How numerical loops are compiled: all alike, since the compiler compiles its own functions for every set of options.

A literal number as an argument, another memory layout of an array, or one array assigned to a row of another one each
cost half a second and more of every user's first run (docs/decisions.md, 0010).

Rows of an array are taken by their numbers, `a, b = w[0], w[1]`: unpacked at once, `a, b = w`, no loop over them is
vectorised, and it takes four to eight times as long.

An installed wheel may hold the loops compiled ahead (`scripts/wheel`): then nothing is compiled, and numba, which takes
its time, is not imported. Without that, as in a checkout, numba compiles a loop when it is first called.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

LIBRARY = "kernels_ahead"  # beside this file: the code, and the table `LIBRARY.json` of the types it is compiled for
VARIABLE = "FFCOMP_JIT"  # not empty: leave the library alone
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

Kind = Any  # hashable: what an argument is, so far as the compiled code depends on it


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function ahead, or when it is first called."""
    return compiled(function, _OPTIONS)


def fast_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function as `kernel` does, and let the compiler reorder its sums."""
    return compiled(function, {**_OPTIONS, "fastmath": True})


def compiled(function: Callable[..., Any], options: dict[str, Any], sources: str | None = "") -> Any:
    """Compile a function with options of numba; `sources` as in `models.jit.jit`."""
    return Kernel(function, options, sources) if ahead() else _by_numba(function, options, sources)


def with_numba(make: Callable[[], Any]) -> Any:
    """Return what a kernel calls and `make` returns, made when a kernel is compiled that calls it."""
    return ByNumba(make) if ahead() else make()


def ahead() -> dict[str, dict[Kind, str]]:
    """Return the symbols in the library by kernel and by the kinds of its arguments; empty: there is no library."""
    return {} if os.environ.get(VARIABLE) else _table()


@cache
def _table() -> dict[str, dict[Kind, str]]:
    try:
        table = json.loads(Path(__file__).with_name(f"{LIBRARY}.json").read_text(encoding="ascii"))
    except OSError:
        return {}
    with suppress(OSError):  # not on Linux: taken to be of the last ten years
        if not set(table["processor"]) <= set(Path("/proc/cpuinfo").read_text(encoding="utf-8").split()):
            return {}
    return {
        name: {tuple(map(_kind_of_json, kinds)): symbol for symbol, kinds in variants.items()}
        for name, variants in table["kernels"].items()
    }


def _kind_of_json(kind: Any) -> Kind:
    return tuple(map(_kind_of_json, kind)) if isinstance(kind, list) else kind


def kind_of(value: Any) -> Kind:
    """Return what a kernel's code must know of an argument.

    Of an array type, dimensions, and whether its rows are contiguous; of tuples the kinds of what they hold; else the
    type's letter as of an array's. A number of Python is one of 64 bits.
    """
    if isinstance(value, np.ndarray):
        flags = value.flags
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return _name_of(value.dtype), value.ndim, layout
    if isinstance(value, tuple):
        kinds = tuple(map(kind_of, value))
        return kinds if type(value) is tuple else (type(value).__qualname__, kinds)
    if isinstance(value, np.generic):
        return _name_of(value.dtype)
    return _SCALARS.get(type(value))  # None: no kernel takes it


_SCALARS = {float: "f8", int: "i8", bool: "b1", complex: "c16"}


@cache
def _name_of(dtype: np.dtype[Any]) -> str:
    return dtype.str[1:] if dtype.names is None else ",".join(dtype.names)


class ByNumba:
    """What only numba knows, made when a kernel is compiled that calls it."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make

    @cached_property
    def made(self) -> Any:
        """What numba calls."""
        return self._make()

    @property
    def _numba_type_(self) -> Any:  # numba asks every value for this
        from models.jit import numba_type

        return numba_type(self.made)


class Kernel(ByNumba):
    """A function that is compiled ahead for some kinds of arguments; for others numba compiles it."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any], sources: str | None) -> None:
        super().__init__(lambda: _by_numba(function, options, sources))
        self._variants = ahead().get(_name(function), {})
        self._ready: dict[Kind, Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled code."""
        kinds = tuple(map(kind_of, arguments))
        run = self._ready.get(kinds)
        if run is None:
            symbol = self._variants.get(kinds)
            run = getattr(import_module(f"models.{LIBRARY}"), symbol) if symbol else self.made
            self._ready[kinds] = run
        return run(*arguments)


def _by_numba(function: Callable[..., Any], options: dict[str, Any], sources: str | None) -> Any:
    from models.jit import jit  # takes its time to import

    return jit(function, options, sources)


def _name(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__qualname__}"
