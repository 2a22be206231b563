"""The public functions and the objects that they return; `import ffcomp` offers them by the same names.

A verb's module is imported with its first use: whoever compensates a print does not wait for the diagnosis.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ffcomp.api.comparison import compare
    from ffcomp.api.compensation import compensate
    from ffcomp.api.estimation import estimate
    from ffcomp.api.machines import load_machine
    from ffcomp.api.measurements import diagnose, gap, identify
    from ffcomp.api.responses import frf
    from ffcomp.api.simulation import simulate

__all__ = ["compare", "compensate", "diagnose", "estimate", "frf", "gap", "identify", "load_machine", "simulate"]

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


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
