"""The public functions and the objects that they return; `import ffcomp` offers them by the same names."""

from ffcomp.api.machines import frf, load_machine
from ffcomp.api.measurements import diagnose, gap, identify
from ffcomp.api.prints import compare, compensate, estimate, simulate

__all__ = ["compare", "compensate", "diagnose", "estimate", "frf", "gap", "identify", "load_machine", "simulate"]
