"""Effects that are confounded with those found, and how to tell them apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.report.diagnose.inputs import ReportInput
from ffcomp.report.diagnose.words import title
from models.effects.catalogue import CATALOGUE

WORTH_SHOWING = 0.3  # cos²
MOST = 5


@dataclass(frozen=True, slots=True)
class Confounded:
    """One pair of confounded effects."""

    effect: str
    other: str
    title: str
    cos2: str
    apart: str  # how to tell them apart; '' if the catalogue does not say


def confounded(given: ReportInput) -> list[Confounded]:
    """List for each effect of the best hypothesis the visible ones most like it."""
    alike, own = given.picture.confounding, tuple(given.outcome.effects)
    found = []
    for name in own:
        if name not in alike.names:
            continue
        row = alike.cos2[alike.names.index(name)]
        others = [(alike.names[i], float(row[i])) for i in np.argsort(-row) if alike.names[i] not in own]
        found += [_one(name, other, c) for other, c in others[:MOST] if c > WORTH_SHOWING]
    return found


def _one(name: str, other: str, cos2: float) -> Confounded:
    apart = CATALOGUE[name].confounded_with.get(other) or CATALOGUE[other].confounded_with.get(name) or ""
    return Confounded(name, other, title(other), f"{cos2:.2f}", apart)
