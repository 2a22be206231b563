"""The full bank: which cases, in which order, so that any beginning of it is a fair small bank."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from validation.blind.cases import NEVER_TOGETHER
from validation.blind.kinds import KINDS, MACHINES

# of six cases on a machine three hide one effect, and one each two, nothing, and what is outside the catalogue
ROUND = ("single", "nothing", "single", "outside", "single", "pair")
# in turn, for every machine and what is hidden
CONDITIONS: Mapping[str, Sequence[str]] = {
    "delta": ("usual", "free-damping", "rest", "rough-file"),
    "nozzle": ("free-damping", "usual", "joined", "rest"),
    "cartesian": ("rest", "free-damping", "usual", "rough-file"),
    "corexy": ("joined", "rest", "free-damping", "usual"),
    "axis": ("rough-file", "usual", "rest", "free-damping"),
    "servo": ("usual", "rest", "rough-file"),
}
FULL = 240


def full_bank(
    count: int = FULL, seed: int = 1, machines: Sequence[str] = tuple(MACHINES)
) -> dict[str, tuple[int, str]]:
    """Return the name of each case → its seed and stratum; a larger bank begins with the smaller.

    The names tell nothing. Machines come in turn; each goes through ROUND, beginning at another place of it. Where a
    machine is of several kinds, these take turns in what they hide.
    """
    cases: dict[str, tuple[int, str]] = {}
    kinds = [kind for machine in machines for kind in MACHINES[machine]]
    names = {(kind, what): _in_turn(kind, what, seed) for kind in kinds for what in set(ROUND)}
    seen: dict[tuple[str, str], int] = {}
    for n in range(count):
        turn, machine = n // len(machines), machines[n % len(machines)]
        which = list(MACHINES).index(machine)
        what = ROUND[(turn + which) % len(ROUND)]
        before = seen.get((machine, what), 0)
        seen[machine, what] = before + 1
        several, conditions = MACHINES[machine], CONDITIONS[machine]
        kind = several[before % len(several)]
        condition = conditions[before // len(several) % len(conditions)]
        if condition == "rest" and what != "single":  # a rest is beside one effect
            condition = "usual"
        name = hashlib.sha256(f"{seed} {machine} {turn}".encode()).hexdigest()[:8]
        own = 10000 * seed + 100 * turn + which
        cases[f"case-{name}"] = (own, f"{kind}/{what}/{condition}:{next(names[kind, what])}")
    return cases


def _choices(machine: str, what: str) -> list[str]:
    kind = KINDS[machine]
    if what == "nothing":
        return ["none"]
    if what == "outside":
        return list(kind.outside)
    if what == "pair":
        pairs = [{a, b} for a, b in combinations(kind.effects, 2) if {a, b} not in NEVER_TOGETHER]
        return ["+".join(sorted(pair)) for pair in pairs]
    return list(kind.effects)


def _in_turn(machine: str, what: str, seed: int) -> Iterator[str]:
    """Each once in a shuffled order, then again in another; the same however many are wanted."""
    choices = _choices(machine, what)
    digest = hashlib.sha256(f"{machine} {what}".encode()).digest()
    rng = np.random.default_rng([seed, int.from_bytes(digest[:4], "big")])
    for _ in range(math.ceil(10000 / len(choices))):
        yield from map(str, rng.permutation(choices))
