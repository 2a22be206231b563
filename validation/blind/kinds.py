"""The kinds of machines that the bank hides something in: how each is drawn, driven, measured and written down."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from validation.blind.delta import machines as delta_machines
from validation.blind.delta import real as delta
from validation.blind.delta.hidden import EFFECTS as DELTA_EFFECTS
from validation.blind.delta.numbers import carriages_of
from validation.blind.delta.outside import OUTSIDE as DELTA_OUTSIDE
from validation.blind.printer.motions import KINDS as MOTIONS
from validation.blind.printer.motions import Motion, Path, Place
from validation.blind.printer.real import FloatArray, Hide, Labels, Reading, Real, Rng, Tables
from validation.blind.sensors import columns_of
from validation.blind.straight import forced, single, turning
from validation.blind.straight import machines as straight
from validation.blind.straight.forced_effects import EFFECTS as FORCED_EFFECTS
from validation.blind.straight.forced_effects import OUTSIDE as FORCED_OUTSIDE
from validation.blind.straight.forced_effects import TURNING
from validation.blind.straight.hidden import damped_by_belts, effects_of
from validation.blind.straight.outside import OUTSIDE as STRAIGHT_OUTSIDE

MEASURED = (  # motion, place, name, loudness
    ("multisine", 0, "centre", 1.0),
    ("multisine", 0, "loud", 2.5),
    ("multisine", 1, "left", 1.4),
    ("infill", 2, "high", 1.0),
    ("slow", 3, "back", 1.0),
    ("steps", 3, "back", 1.0),
    ("turns", 4, "up", 1.0),
)
FRESH = (("multisine", 5, "fresh", 1.2), ("infill", 5, "fresh", 1.0))
OF_A_STAGE = (
    ("multisine", 0, "centre", 1.0),
    ("strokes", 0, "long", 1.0),
    ("strokes", 0, "quick", 1.8),
    ("slow", 0, "back", 1.0),
    ("steps", 0, "back", 0.6),
    ("turns", 0, "up", 1.0),
)
FRESH_OF_A_STAGE = (("multisine", 5, "fresh", 1.2), ("strokes", 5, "fresh", 1.3))
Given: TypeAlias = Callable[[Tables, FloatArray, Reading, Rng], dict[str, FloatArray]]
Replayed: TypeAlias = Callable[[Real | None, Reading], Reading]
Columns: TypeAlias = Callable[[Tables, Mapping[str, FloatArray]], dict[str, FloatArray]]
Damped: TypeAlias = Callable[[Tables, float], tuple[Tables, dict[str, Any]]]


@dataclass(frozen=True, eq=False)
class Kind:
    """One kind of machine with one set of sensors."""

    draw: Callable[[Rng, Sequence[str]], Tables]  # of the names of what will be hidden
    file_of: Callable[[Tables, float, Rng], Tables]
    played: Callable[[Real, Mapping[str, Any], Motion, bool], Reading]
    probes: Callable[[Tables, float], Iterator[Tables]]
    places: Callable[[Tables, Rng], list[Place]]
    effects: Mapping[str, Hide]
    outside: Mapping[str, Hide]
    restated: Callable[[Labels, Tables, Tables], Labels]  # of tables, of the real printer, and of its file
    sensors: str
    axes: str  # of the command in a run
    moving: tuple[float, float, float] = (1.0, 1.0, 1.0)  # 0 where a motion stays at its place
    measured: Sequence[tuple[str, int, str, float]] = MEASURED
    fresh: Sequence[tuple[str, int, str, float]] = FRESH
    repeats: int = 2  # of the first motions
    force: Given | None = None  # what is recorded of the force that drives it, by column
    replayed: Replayed | None = None  # another machine under a reading's forces, or the reading itself, as it is judged
    columns: Columns = lambda _, measured: columns_of(measured)
    # the machine with a share of its damping in its belts, and the table of it where a file that says nothing is wrong
    damped: Damped | None = None
    # numbers of a file that knows nothing of them where damping is anywhere, and which of `probes` is of each
    unknown: Mapping[str, int] = field(default_factory=dict)

    def command(self, firmware: Mapping[str, Any], path: FloatArray, axes: str) -> FloatArray:
        """Return what a run's file has as the command, (n, axes) mm, of a nozzle's path."""
        return carriages_of(firmware, path) if axes == "ABC" else path[:, : len(axes)]

    def motions(self, machine: Tables, rng: Rng, seconds: float, short: bool) -> tuple[tuple[Motion, ...], ...]:
        """Draw what is measured, and what will be measured afterwards at other places."""
        places = self.places(machine, rng)

        def motion(what: str, where: int, name: str, loudness: float) -> Motion:
            path = MOTIONS[what](rng, places[where], seconds, loudness)
            return Motion(f"{what}-{name}", _held(path, self.moving), seconds)

        measured = [motion(*each) for each in self.measured]
        fresh = [motion(*each) for each in self.fresh]
        return (tuple(measured), tuple(fresh)) if not short else ((measured[0], measured[2]), tuple(fresh[:1]))


def _held(path: Path, moving: tuple[float, float, float]) -> Path:
    def held(t: FloatArray) -> FloatArray:
        found = path(t)
        return np.asarray(found[:1] + moving * (found - found[:1]))

    return path if all(moving) else held


def _delta(rng: Rng, names: Sequence[str]) -> Tables:
    machine = delta_machines.draw_machine(rng)
    if "center_of_mass" in names or ("force_map" in names and rng.random() < 0.5):
        machine["effector"]["force_map"] = "paper"
    if "arm_inertia" in names:  # of tubes of steel: of the lightest arms' inertia nothing is seen
        machine["carriage"]["arm_pair_mass_kg"] = float(rng.uniform(0.08, 0.15))
    return machine


def _delta_played(real: Real, firmware: Mapping[str, Any], motion: Motion, coarse: bool) -> Reading:
    return delta.played(real, firmware, motion, *([delta.COARSE_STEP_S] if coarse else []))


def _round_places(machine: Tables, rng: Rng) -> list[Place]:
    reach = 0.62 * machine["kinematics"]["print_radius_mm"]
    turn = rng.uniform(0, 2 * np.pi)
    places: list[Place] = [(0.0, 0.0, 30.0)]
    for n in range(5):
        angle = turn + 2 * np.pi * n / 5 + rng.uniform(-0.3, 0.3)
        height = rng.uniform(15, 60) if n % 2 == 0 else rng.uniform(90, 160)
        places.append((reach * np.cos(angle), reach * np.sin(angle), height))
    return places


def _bed_places(machine: Tables, rng: Rng) -> list[Place]:
    size = [machine["kinematics"][f"{axis}_range_mm"][1] for axis in "xy"]
    middle: Place = (size[0] / 2, size[1] / 2, 30.0)
    shares = [(0.25, 0.7), (0.75, 0.3), (0.3, 0.25), (0.7, 0.72), (0.5, 0.25)]
    moved = [(x + rng.uniform(-0.05, 0.05), y + rng.uniform(-0.05, 0.05)) for x, y in shares]
    return [middle, *((size[0] * x, size[1] * y, float(rng.uniform(15, 140))) for x, y in moved)]


def _straight(kind: str, sensors: str) -> Kind:
    return Kind(
        draw=lambda rng, names: straight.draw_machine(rng, kind, names),
        file_of=straight.file_of,
        played=straight.played,
        probes=straight.probes,
        places=_bed_places,
        effects=effects_of(kind),
        outside=STRAIGHT_OUTSIDE,
        restated=straight.restated,
        sensors=sensors,
        axes="xyz",
        moving=(1.0, 1.0, 0.0),
        damped=damped_by_belts,
    )


_DELTA = Kind(
    draw=_delta,
    file_of=delta_machines.file_of,
    played=_delta_played,
    probes=delta_machines.probes,
    places=_round_places,
    effects=DELTA_EFFECTS,
    outside=DELTA_OUTSIDE,
    restated=delta_machines.restated,
    sensors="all",
    axes="ABC",
    damped=delta_machines.damped_by_belts,
    unknown=dict(zip(delta_machines.DAMPERS, (3, 4), strict=True)),
)
_AXIS = Kind(
    draw=lambda rng, names: single.draw_machine(rng),
    file_of=single.file_of,
    played=straight.played,
    probes=straight.probes,
    places=lambda machine, rng: [(0.0, 0.0, 0.0)] * 6,
    effects=single.EFFECTS,
    outside=single.OUTSIDE,
    restated=single.restated,
    sensors="axis",
    axes="q",
    moving=(1.0, 0.0, 0.0),
    damped=damped_by_belts,
)
_FORCED = Kind(
    draw=forced.draw_machine,
    file_of=forced.file_of,
    played=forced.played,
    probes=forced.probes,
    places=lambda machine, rng: [(0.0, 0.0, 0.0)] * 6,
    effects=FORCED_EFFECTS,
    outside=FORCED_OUTSIDE,
    restated=forced.restated,
    sensors="encoder",
    axes="q",
    moving=(1.0, 0.0, 0.0),
    measured=OF_A_STAGE,
    fresh=FRESH_OF_A_STAGE,
    repeats=1,  # no two runs have the same force
    force=forced.given,
    replayed=forced.replayed,
)
_TURNING = replace(
    _FORCED,
    draw=turning.draw_machine,
    file_of=turning.file_of,
    effects=TURNING,
    restated=turning.restated,
    force=turning.given,
    columns=turning.columns,
)
KINDS: Mapping[str, Kind] = {
    "delta": _DELTA,
    "nozzle": replace(_DELTA, sensors="effector", axes="xyz"),  # what owners have: one chip on the nozzle holder
    "cartesian": _straight("cartesian", "head-and-bed"),
    "corexy": _straight("corexy", "effector"),
    "axis": _AXIS,
    "axis-by-force": _FORCED,
    "turning": _TURNING,
}
MACHINES: Mapping[str, Sequence[str]] = {  # that a bank takes in turn; those of one place in it take turns too
    **{name: (name,) for name in ("delta", "nozzle", "cartesian", "corexy", "axis")},
    "servo": ("axis-by-force", "turning"),
}
