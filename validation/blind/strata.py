"""The full bank: which cases, in which order, so that any beginning of it is a fair small bank."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from validation.blind.bank import NEVER_TOGETHER
from validation.blind.hidden import EFFECTS
from validation.blind.outside import OUTSIDE

SHARES: Mapping[str, float] = {
    "single": 0.32,
    "nothing": 0.14,
    "outside": 0.13,
    "pair": 0.13,
    "weak": 0.10,
    "sensors": 0.06,
    "rough-file": 0.04,
    "exact-file": 0.02,
    "few": 0.03,
    "nozzle": 0.03,
}


def full_bank(count: int, seed: int = 1) -> dict[str, tuple[int, str]]:
    """Name of each case → its seed and stratum; a larger bank begins with the smaller. The names tell nothing."""
    places = [((n + 0.5) / share, kind) for kind, share in SHARES.items() for n in range(math.ceil(share * count) + 1)]
    kinds = [kind for _, kind in sorted(places)[:count]]
    hidden = {kind: _in_turn(kind, kinds.count(kind), seed) for kind in SHARES}
    cases = {}
    for n, kind in enumerate(kinds):
        name = hashlib.sha256(f"{seed} {n}".encode()).hexdigest()[:8]
        cases[f"case-{name}"] = (10000 * seed + n, f"{kind}:{next(hidden[kind])}")
    return cases


def _choices(kind: str) -> list[str]:
    if kind == "nothing":
        return ["none"]
    if kind == "outside":
        return list(OUTSIDE)
    if kind == "pair":
        pairs = [{a, b} for a, b in combinations(EFFECTS, 2) if {a, b} not in NEVER_TOGETHER]
        return ["+".join(sorted(pair)) for pair in pairs]
    return list(EFFECTS)


def _in_turn(kind: str, count: int, seed: int) -> Iterator[str]:
    """Each once in a shuffled order, then again in another; the same however many are wanted."""
    rng, choices = np.random.default_rng([seed, list(SHARES).index(kind)]), _choices(kind)
    for _ in range(math.ceil(count / len(choices))):
        yield from map(str, rng.permutation(choices))
