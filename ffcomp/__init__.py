"""ffcomp: feedforward vibration compensation for the G-code of 3-D printers.

    import ffcomp

    machine = ffcomp.load_machine("mp-delta-pro")
    result = ffcomp.compensate("print.gcode", machine, "out.gcode")
    motion = ffcomp.simulate("out.gcode", machine)

The functions below are the public interface, with the objects that they return. Each verb is also the folder that does
the work: `ffcomp.compensate` can be called, and `ffcomp.compensate.batch` is a module in it. Nothing heavy is imported
before a verb is called.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from ffcomp.numerics.numba_cache import ensure_cache_folder
from ffcomp.version import __version__

if TYPE_CHECKING:
    from ffcomp.api import (
        compare,
        compensate,
        diagnose,
        estimate,
        frf,
        gap,
        identify,
        load_machine,
        simulate,
    )

__all__ = [
    "__version__",
    "compare",
    "compensate",
    "diagnose",
    "estimate",
    "frf",
    "gap",
    "identify",
    "load_machine",
    "simulate",
]

FUNCTIONS = ("frf", "gap", "load_machine")
FOLDERS = ("compare", "compensate", "diagnose", "estimate", "identify", "simulate")  # verbs that are folders as well

ensure_cache_folder()  # for compiled code, before anything is imported that compiles


class _Verb(ModuleType):
    """A folder that can be called as the public function of its name."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Call the public function; see `ffcomp.api`."""
        return self._function(*arguments, **options)

    @property
    def _function(self) -> Any:
        return getattr(import_module("ffcomp.api"), self.__name__.removeprefix("ffcomp."))

    @property
    def __signature__(self) -> Any:
        """The public function's, for `help` and editors."""
        import inspect

        return inspect.signature(self._function)


class _Package(ModuleType):
    """The ffcomp package: a folder that the import system binds here becomes callable, whoever imports it first."""

    def __setattr__(self, name: str, value: Any) -> None:
        """Bind a name; make a verb's folder callable."""
        if name in FOLDERS and isinstance(value, ModuleType):
            value.__class__ = _Verb
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name in FOLDERS:
        return import_module(f"{__name__}.{name}")
    if name in FUNCTIONS:
        return getattr(import_module(f"{__name__}.api"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
