"""Where two machine files differ: values, added and removed, and what it does to the vibrations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import design_machine
from models.file import Entry
from models.machine import Machine


@dataclass(frozen=True)
class Difference:
    """One key; None where a file does not have it."""

    key: str
    old: Any
    new: Any
    unit: str
    relative: tuple[float, ...]  # change over the old value, of each number; empty where that means nothing
    provenance: str  # of the new value


def differences(old: Sequence[Entry], new: Sequence[Entry]) -> Iterator[Difference]:
    """Every value that is not the same, in the order of the new file, what was removed last."""
    before = {entry.key: entry for entry in old}
    for entry in new:
        was = before.pop(entry.key, None)
        if was is None or was.value != entry.value:
            value = None if was is None else was.value
            yield Difference(entry.key, value, entry.value, entry.unit, _relative(value, entry.value), entry.provenance)
    for entry in before.values():
        yield Difference(entry.key, entry.value, None, entry.unit, (), "")


def _relative(old: Any, new: Any) -> tuple[float, ...]:
    try:
        before, after = (np.atleast_1d(np.array(value, dtype=float)) for value in (old, new))
    except (TypeError, ValueError):
        return ()
    if before.shape != after.shape or not np.all(np.isfinite(before)) or np.any(before == 0):
        return ()
    return tuple(float(change) for change in after / before - 1)


def mode_changes(old: Machine, new: Machine) -> FloatArray:
    """Natural frequencies at the bed's middle, slowest first, effects included where the linear model has them.

    Returns
    -------
    (k, 2) Hz, columns old and new; k = 6 unless a mode is overdamped in one of them.
    """
    found = [design_machine(machine)[0].vibration.modes_at(np.zeros(2)).frequencies_hz for machine in (old, new)]
    count = min(map(len, found))
    return np.stack([each[:count] for each in found], axis=1)
