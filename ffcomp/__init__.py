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
    from ffcomp.api.comparison import compare
    from ffcomp.api.compensation import compensate
    from ffcomp.api.estimation import estimate
    from ffcomp.api.machines import load_machine
    from ffcomp.api.measurements import diagnose, gap, identify
    from ffcomp.api.responses import frf
    from ffcomp.api.simulation import simulate

_MODULES = {
    "compare": "comparison",
    "compensate": "compensation",
    "diagnose": "measurements",
    "estimate": "estimation",
    "frf": "responses",
    "gap": "measurements",
    "identify": "measurements",
    "load_machine": "machines",
    "simulate": "simulation",
}

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
    if name in _MODULES:
        return getattr(import_module(f"ffcomp.api.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
