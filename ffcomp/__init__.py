"""ffcomp: feedforward vibration compensation for the G-code of delta 3-D printers."""

from ffcomp.numerics.numba_cache import find_a_place

__version__ = "0.1.0"

find_a_place()  # for compiled code, before anything is imported that compiles
