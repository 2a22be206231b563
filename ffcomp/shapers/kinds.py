"""All kinds of shapers by name: of pulses, and smooth ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ffcomp.shapers import pulses
from ffcomp.shapers.pulses import Shaper
from ffcomp.shapers.smooth import KERNELS, smooth

SHAPERS: dict[str, Callable[[float, float], Shaper]] = {
    "zv": pulses.zv,
    "mzv": pulses.mzv,
    "zvd": pulses.zvd,
    "zvdd": pulses.zvdd,
    "zvddd": pulses.zvddd,
    "ei": pulses.ei,
    "2hump_ei": pulses.two_hump_ei,
    "3hump_ei": pulses.three_hump_ei,
    **{name: partial(smooth, name) for name in KERNELS},
}

USUAL = ("zv", "mzv", "zvd", "ei", "2hump_ei", "3hump_ei")  # what most printers have
