"""How numerical loops are compiled: all with the same options, because each set makes numba compile its own functions.

A literal number as an argument, another memory layout, or an array assigned to a row of another array: each costs half
a second or more of every user's first run (docs/decisions.md, 0010).

Read the rows of an array by index, `a, b = w[0], w[1]`. Unpacking, `a, b = w`, prevents vectorisation and takes four to
eight times as long. Return no NamedTuple to Python: numba makes it by Python code, and Ctrl-C crashes it.

An installed wheel may contain loops compiled ahead (`scripts/wheel`). Then nothing is compiled and numba, which is slow
to import, is not imported. Otherwise, as in a checkout, numba compiles a loop on its first call.
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

LIBRARY = "kernels_ahead"  # in this folder: the code, and `LIBRARY.json` with the types it was compiled for
VARIABLE = "FFCOMP_JIT"  # not empty: do not use the library
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

BEFORE_COMPILING: list[Callable[[], None]] = []  # called, once, before this process compiles
Kind = Any  # hashable: the type of an argument, as far as the compiled code depends on it


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function ahead of time or on its first call."""
    return compiled(function, _OPTIONS)


def fast_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function as `kernel` does, with sums that the compiler may reorder."""
    return compiled(function, {**_OPTIONS, "fastmath": True})


def compiled(function: Callable[..., Any], options: dict[str, Any], sources: str | None = "") -> Any:
    """Compile a function with options of numba; `sources` as in `models.jit.jit`."""
    return Kernel(function, options, sources) if ahead() else _by_numba(function, options, sources)


def with_numba(make: Callable[[], Any]) -> Any:
    """Return a callee for kernels; `make` makes it when a kernel that calls it is compiled."""
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
    with suppress(OSError):  # not on Linux: assume a processor of the last ten years
        if not set(table["processor"]) <= set(Path("/proc/cpuinfo").read_text(encoding="utf-8").split()):
            return {}
    return {
        name: {tuple(map(_kind_of_json, kinds)): symbol for symbol, kinds in variants.items()}
        for name, variants in table["kernels"].items()
    }


def _kind_of_json(kind: Any) -> Kind:
    return tuple(map(_kind_of_json, kind)) if isinstance(kind, list) else kind


def kind_of(value: Any) -> Kind:
    """Return the kind of an argument, on which a kernel's code depends.

    Arrays: type, dimensions, and whether rows are contiguous. Tuples: the kinds of their elements. Otherwise the
    letter of the array type; Python numbers have 64 bits.
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
    return _SCALARS.get(type(value))  # None: no kernel accepts it


_SCALARS = {float: "f8", int: "i8", bool: "b1", complex: "c16"}


@cache
def _name_of(dtype: np.dtype[Any]) -> str:
    return dtype.str[1:] if dtype.names is None else ",".join(dtype.names)


class ByNumba:
    """An object that only numba uses, made when a kernel that calls it is compiled."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make

    @cached_property
    def made(self) -> Any:
        """The function that numba calls."""
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
    from models.jit import jit  # slow to import

    return jit(function, options, sources, BEFORE_COMPILING)


def _name(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__qualname__}"
