"""The kinds of machines that the bank hides something in: how each is drawn, driven, measured and written down."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from validation.blind import delta, servo, straight
from validation.blind.motions import KINDS as MOTIONS
from validation.blind.motions import Motion, Path, Place
from validation.blind.real import FloatArray, Hide, Labels, Reading, Real, Rng, Tables
from validation.blind.sensors import columns_of
from validation.plants.delta_plant import carriages_of

MEASURED = (  # motion, place, name, loudness
    ("multisine", 0, "centre", 1.0),
    ("multisine", 0, "loud", 2.5),
    ("multisine", 1, "left", 1.4),
    ("infill", 2, "high", 1.0),
    ("slow", 3, "back", 1.0),
    ("steps", 3, "back", 1.0),
    ("turns", 4, "up", 1.0),
)
OF_A_STAGE = (
    ("multisine", 0, "centre", 1.0),
    ("strokes", 0, "long", 1.0),
    ("strokes", 0, "quick", 1.8),
    ("slow", 0, "back", 1.0),
    ("steps", 0, "back", 0.6),
    ("turns", 0, "up", 1.0),
)
Given: TypeAlias = Callable[[Tables, FloatArray, Reading, Rng], dict[str, FloatArray]]
Replayed: TypeAlias = Callable[[Real | None, Reading], Reading]
Columns: TypeAlias = Callable[[Tables, Mapping[str, FloatArray]], dict[str, FloatArray]]
Damped: TypeAlias = Callable[[Tables, float], tuple[Tables, dict[str, Any]]]


@dataclass(frozen=True, eq=False)
class Kind:
    """One kind of machine with one set of sensors."""

    draw: Callable[[Rng, Sequence[str]], Tables]  # of the names of what will be hidden
    file_of: Callable[[Tables, float, Rng], Tables]
    played: Callable[[Real, Mapping[str, Any], Motion], Reading]
    probes: Callable[[Tables, float], Iterator[Tables]]
    places: Callable[[Tables, Rng], list[Place]]
    effects: Mapping[str, Hide]
    outside: Mapping[str, Hide]
    restated: Callable[[Labels, Tables, Tables], Labels]  # of tables, of the real printer, and of its file
    sensors: str
    axes: str  # of the command in a run
    moving: tuple[float, float, float] = (1.0, 1.0, 1.0)  # 0 where a motion stays at its place
    measured: Sequence[tuple[str, int, str, float]] = MEASURED
    repeats: int = 2  # of the first motions
    force: Given | None = None  # the recorded force that drives it, by column
    replayed: Replayed | None = None  # another machine under a reading's forces, or the reading itself, to compare
    columns: Columns = lambda _, measured: columns_of(measured)
    # the machine with a share of its damping in its belts, and the table of it where a file that says nothing is wrong
    damped: Damped | None = None
    # numbers of a file that knows nothing of them where damping is anywhere, and which of `probes` is of each
    unknown: Mapping[str, int] = field(default_factory=dict)

    def command(self, firmware: Mapping[str, Any], path: FloatArray, axes: str) -> FloatArray:
        """Return what a run's file has as the command, (n, axes) mm, of a nozzle's path."""
        return carriages_of(firmware, path) if axes == "ABC" else path[:, : len(axes)]

    def motions(self, machine: Tables, rng: Rng, seconds: float) -> tuple[Motion, ...]:
        """Draw what is measured."""
        places = self.places(machine, rng)

        def motion(what: str, where: int, name: str, loudness: float) -> Motion:
            path = MOTIONS[what](rng, places[where], seconds, loudness)
            return Motion(f"{what}-{name}", _held(path, self.moving), seconds)

        return tuple(motion(*each) for each in self.measured)


def _held(path: Path, moving: tuple[float, float, float]) -> Path:
    def held(t: FloatArray) -> FloatArray:
        found = path(t)
        return np.asarray(found[:1] + moving * (found - found[:1]))

    return path if all(moving) else held


def _at_zero(machine: Tables, rng: Rng) -> list[Place]:
    return [(0.0, 0.0, 0.0)] * 6


def _kind(module: Any, **more: Any) -> Kind:
    """Return the kind of machine that a module draws, plays and writes down."""
    names = {"draw": "draw_machine", **{name: name for name in ("file_of", "played", "probes", "restated")}}
    return Kind(**{"places": _at_zero, **{key: getattr(module, name) for key, name in names.items()}, **more})


def _straight(kind: str, sensors: str) -> Kind:
    return _kind(
        straight,
        draw=lambda rng, names: straight.draw_machine(rng, kind, names),
        places=straight.places,
        effects=straight.effects_of(kind),
        outside=straight.OUTSIDE,
        sensors=sensors,
        axes="xyz",
        moving=(1.0, 1.0, 0.0),
        damped=straight.damped_by_belts,
    )


_DELTA = _kind(
    delta,
    places=delta.places,
    effects=delta.EFFECTS,
    outside=delta.OUTSIDE,
    sensors="all",
    axes="ABC",
    damped=delta.damped_by_belts,
    unknown=dict(zip(delta.DAMPERS, (3, 4), strict=True)),
)
_AXIS = _kind(
    straight,
    draw=straight.draw_axis,
    file_of=straight.file_of_axis,
    restated=straight.restated_axis,
    effects=straight.EFFECTS_OF_AXIS,
    outside=straight.OUTSIDE_OF_AXIS,
    sensors="axis",
    axes="q",
    moving=(1.0, 0.0, 0.0),
    damped=straight.damped_by_belts,
)
_FORCED = _kind(
    servo,
    effects=servo.EFFECTS,
    outside=servo.OUTSIDE,
    sensors="encoder",
    axes="q",
    moving=(1.0, 0.0, 0.0),
    measured=OF_A_STAGE,
    repeats=1,  # no two runs have the same force
    force=servo.given,
    replayed=servo.replayed,
)
_TURNING = replace(
    _FORCED,
    draw=servo.turning_draw_machine,
    file_of=servo.turning_file_of,
    effects=servo.TURNING,
    restated=servo.turning_restated,
    force=servo.turning_given,
    columns=servo.turning_columns,
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
MACHINES: Mapping[str, Sequence[str]] = {  # that a benchmark takes in turn; those of one place in it take turns too
    **{name: (name,) for name in ("delta", "nozzle", "cartesian", "corexy", "axis")},
    "servo": ("axis-by-force", "turning"),
}
