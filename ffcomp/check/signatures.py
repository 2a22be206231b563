"""What each part would change in what the sensor feels: differences of two simulations.

They are taken around the printer of the last check, not around the machine file's: what the file lacks has been there
before, and changes how the printer answers. So the parts are fitted to the last check first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ffcomp.check.felt import Felt
from ffcomp.check.parts import Part, parts_of, simulated
from ffcomp.check.weighed import ByExperiment, weighed
from ffcomp.record.plan import Experiment
from models.machine import Machine

UNSEEN = 1e-3  # of the signal, root mean squares: nothing can be said of such a part
FITS = 2  # of the last check


class Signatures:
    """What a machine's printer feels, and what its parts would change, by their units."""

    def __init__(self, machine: Machine, experiments: Sequence[Experiment]) -> None:
        self.machine, self.experiments = machine, experiments
        parts = parts_of(machine)
        probed = [part.changed(machine, part.probe) for part in parts]
        played = {each.name: simulated([machine, *probed], each.motion) for each in experiments}
        self.expected: ByExperiment = {name: found[0] for name, found in played.items()}
        size = np.sqrt(sum(np.sum(values**2) for values in self.expected.values()))
        self.of: dict[Part, ByExperiment] = {}
        for k, part in enumerate(parts):
            own = {name: (found[k + 1] - found[0]) / part.probe for name, found in played.items()}
            if np.sqrt(sum(np.sum((part.probe * values) ** 2) for values in own.values())) > UNSEEN * size:
                self.of[part] = own

    def at(self, sizes: Mapping[Part, float]) -> dict[Part, tuple[ByExperiment, ByExperiment]]:
        """Return, of parts changed by so much each, what that changes and the signature there."""
        many = [part.changed(self.machine, x) for part, size in sizes.items() for x in (size, size + part.probe)]
        found: dict[Part, tuple[dict[str, Any], dict[str, Any]]] = {part: ({}, {}) for part in sizes}
        for each in self.experiments:
            played = simulated(many, each.motion)
            for k, part in enumerate(sizes):
                found[part][0][each.name] = played[2 * k] - self.expected[each.name]
                found[part][1][each.name] = (played[2 * k + 1] - played[2 * k]) / part.probe
        return dict(found)


def fitted(first: Signatures, felt: Sequence[Felt]) -> Signatures:
    """Return the signatures around the printer that was felt."""
    around = first
    for _ in range(FITS):
        expected = [each.replaced(around.expected[each.name]) for each in felt]
        problem = weighed([(now, then) for now, then in zip(felt, expected, strict=True)])
        parts = [part for part in around.of if not part.special]
        columns = [problem.column(around.of[part]) for part in parts]
        values = problem.fit(columns, [part.usual for part in parts]).values
        machine = around.machine
        for part, value in zip(parts, values.tolist(), strict=True):
            machine = part.changed(machine, float(np.clip(value, part.lowest, part.highest)))
        around = Signatures(machine, first.experiments)
    return around
