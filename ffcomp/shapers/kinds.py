"""All kinds of shapers by name: of pulses, and smooth ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ffcomp.shapers.pulses import Shaper, ei, mzv, three_hump_ei, two_hump_ei, zv, zvd, zvdd, zvddd
from ffcomp.shapers.smooth import KERNELS, smooth

SHAPERS: dict[str, Callable[[float, float], Shaper]] = {
    "zv": zv,
    "mzv": mzv,
    "zvd": zvd,
    "zvdd": zvdd,
    "zvddd": zvddd,
    "ei": ei,
    "2hump_ei": two_hump_ei,
    "3hump_ei": three_hump_ei,
    **{name: partial(smooth, name) for name in KERNELS},
}

USUAL = ("zv", "mzv", "zvd", "ei", "2hump_ei", "3hump_ei")  # what most printers have
