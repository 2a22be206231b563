"""Compile a loop with numba when it is first called, and keep the code on disk.

The cache and `numba_type` use names of numba that are not public (docs/decisions.md, 0010).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys


class KernelCache:
    """Numba's cache of one kernel, made on its first call: most of the 270 kernels are never called.

    Before it loads compiled code, numba fills its function tables (0.2 s). Only compiling needs them.
    """

    def __init__(self, function: Callable[..., Any], sources: str, waiting: list[Callable[[], None]]) -> None:
        """Cache a function's code until its file changes, or `sources` does if there are any."""
        self._function, self._sources, self._waiting = function, sources, waiting

    @cached_property
    def files(self) -> FunctionCache:
        """Numba's own cache."""
        files = FunctionCache(self._function)
        if self._sources:
            files._cache_file._source_stamp = self._sources
        return files

    def __getattr__(self, name: str) -> Any:
        """Return what numba's own cache has."""
        return getattr(self.files, name)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load compiled code for these types; if there is none, fill the tables and return None."""
        rtsys.initialize(target_context)  # the allocator of arrays, which loaded code calls
        with self.files._guard_against_spurious_io_errors():
            if loaded := self.files._load_overload(sig, target_context):
                return loaded
        while self._waiting:
            self._waiting.pop()()
        return self.files.load_overload(sig, target_context)


def jit(function: Callable[..., Any], options: dict[str, Any], sources: str | None, waiting: list[Any]) -> Any:
    """Return the function as numba compiles it.

    options : of `numba.njit`
    sources : keep the code on disk until this changes; empty: until the function's file changes; None: do not keep it
    waiting : functions that are called, once, before numba compiles
    """
    compiled: Any = njit(**options)(function)
    if sources is not None and hasattr(compiled, "_cache"):  # not with NUMBA_DISABLE_JIT
        compiled._cache = KernelCache(function, sources, waiting)
    return compiled


def numba_type(value: Any) -> Any:
    """Return the numba type of a callee of a kernel."""
    cpu_target.typing_context.refresh()  # it may have been declared just now
    return cpu_target.typing_context.resolve_value_type(value)
