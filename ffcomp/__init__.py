"""ffcomp: feedforward vibration compensation for the G-code of 3-D printers.

    import ffcomp

    machine = ffcomp.load_machine("mp-delta-pro")
    result = ffcomp.compensate("print.gcode", machine, "out.gcode")
    motion = ffcomp.simulate("out.gcode", machine)

The functions below are the public interface, with the objects that they return. The folder that does a verb's work has
its noun: `ffcomp.compensate` is made of `ffcomp.compensation`. Nothing heavy is imported before a verb is called.
"""

from __future__ import annotations

from importlib import import_module
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

ensure_cache_folder()  # for compiled code, before anything is imported that compiles


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(import_module("ffcomp.api"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
