"""ffcomp: feedforward vibration compensation for the G-code of delta 3-D printers."""

from ffcomp.numerics.numba_cache import find_a_place
from ffcomp.version import __version__

__all__ = ["__version__"]

find_a_place()  # for compiled code, before anything is imported that compiles
