"""Monte-Carlo plants: printers around the nominal one whose parameters are all a little off."""

from __future__ import annotations

import numpy as np

from models.machine import Machine
from models.parameters import with_values

FARTHEST = 2.5  # standard deviations; farther draws are drawn again


def draw_plants(machine: Machine, relative_sd: float, seeds: int) -> list[Machine]:
    """Draw machines whose dynamic parameters are all off, each by its own draw from a normal distribution.

    Parameters
    ----------
    machine : Machine
    relative_sd : float
        Standard deviation of parameter / nominal.
    seeds : int
        Seed k gives machine k, independent of the number of seeds.
    """
    parameters = machine.vibration.parameters()
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        off = rng.standard_normal(parameters.columns)
        while np.any(far := np.abs(off) > FARTHEST):
            off[far] = rng.standard_normal(int(far.sum()))
        found.append(with_values(machine, parameters.scaled(off, relative_sd)))
    return found
