"""The error bound of a print, and how fast its moves may be: limits of machine, nozzle, filament and cooling."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.planner.limits import FILAMENT_MM, PlannerLimits, lines_of
from gcode.layers import Labels
from gcode.program import Moves
from gcode.slicing import some
from models.arrays import BoolArray, FloatArray
from models.machine import Machine

_SETTING = re.compile(rb"^; (\w+) = ([\d.]+)", re.MULTILINE)
_FLOW = (b"filament_max_volumetric_speed", b"max_volumetric_speed")
_LAYER_TIME = (b"slowdown_below_layer_time", b"slow_down_layer_time")
_COOLING = (b"cooling", b"slow_down_for_layer_cooling")
FIRST_LAYER = "first layer"
KEPT_FEATURES = ("bridge", "overhang", "ironing", "custom")  # of whose names some word is one of these
SHORTEST_LAYER_S = 5.0  # where neither the user nor the slicer says


@dataclass(frozen=True, slots=True)
class Bound:
    """The error bound of a print, and limits in addition to the machine's own."""

    max_error_um: float
    of_features_um: tuple[tuple[str, float], ...] = ()  # by feature, where it is another
    keep_speed: tuple[str, ...] = ()  # features that keep the slicer's motion
    max_flow_mm3_per_s: float | None = None  # None: the largest in the sliced print
    max_speed_mm_per_s: float | None = None  # None: the machine's
    min_layer_time_s: float | None = None  # None: what the slicer's settings say
    change_speed: tuple[str, ...] = ()  # of what keeps the slicer's motion otherwise; `FIRST_LAYER` is one of them
    safety: float = 0.05  # share of printers within the machine file's uncertainty that may exceed the bound

    @property
    def all_um(self) -> list[float]:
        """The errors that features may have."""
        return [self.max_error_um, *(um for _, um in self.of_features_um)]

    def errors_mm(self, labels: Labels) -> FloatArray:
        """Return each move's own bound, (n,) mm."""
        special = {name.lower(): um for name, um in self.of_features_um}
        by_feature = np.array([special.get(name.lower(), self.max_error_um) for name in labels.features])
        return np.asarray(1e-3 * by_feature[labels.feature])

    def keeps(self, labels: Labels) -> BoolArray:
        """Tell which moves keep the slicer's motion because of their feature, (n,)."""
        kept, changed = ({name.lower() for name in names} for names in (self.keep_speed, self.change_speed))
        by_feature = [
            name in kept or (name not in changed and any(word in name for word in KEPT_FEATURES))
            for name in map(str.lower, labels.features)
        ]
        return np.asarray(by_feature)[labels.feature]

    def unknown_features(self, features: Iterable[str]) -> tuple[str, ...]:
        """Warn of names that are none of the print's kinds of lines."""
        named = {*self.keep_speed, *self.change_speed, *(name for name, _ in self.of_features_um)}
        known = {FIRST_LAYER, *(name.lower() for name in features)}
        unknown = sorted(name for name in named if name.lower() not in known)
        rule = f"the print has {', '.join(filter(None, features)) or 'none that is named'}"
        return (f"No line is of the kind {', '.join(unknown)}: {rule}.",) if unknown else ()

    @property
    def keeps_first_layer(self) -> bool:
        """Whether the first layer keeps the slicer's motion."""
        return FIRST_LAYER not in {name.lower() for name in self.change_speed}


def with_slicer_settings(bound: Bound, head: bytes, tail: bytes) -> Bound:
    """Fill in what the user left open from the slicer's settings, which stand in a file's first or last lines."""
    settings = {key: float(value) for key, value in _SETTING.findall(head + b"\n" + tail) if value.count(b".") < 2}
    flow, shortest_s = bound.max_flow_mm3_per_s, bound.min_layer_time_s
    if flow is None:
        flow = next((settings[key] for key in _FLOW if settings.get(key)), None)
    if shortest_s is None:
        shortest_s = next((settings[key] for key in _LAYER_TIME if key in settings), SHORTEST_LAYER_S)
        if any(settings.get(key) == 0.0 for key in _COOLING):
            shortest_s = 0.0
    return replace(bound, max_flow_mm3_per_s=flow, min_layer_time_s=shortest_s)


LIMITS = {
    "flow": "the nozzle's flow",
    "error_bound": "the error bound",
    "carriage_acceleration": "the carriages' acceleration",
    "speed": "the highest speed",
    "cooling": "cooling",
    "as_sliced": "what keeps the slicer's speed",
    "filament_alone": "retractions and waits",
}
LEAST_SHARE = 0.005  # that is worth a word


def limits_in_words(limited_by: Mapping[str, float]) -> str:
    """Say where the time (s, by limit, as of `time_by_limit`) goes, the most first; an empty text if none is known."""
    seconds = sorted(limited_by.items(), key=lambda each: -each[1])
    whole = max(sum(s for _, s in seconds), 1e-9)
    parts = [f"{LIMITS[name]} {100 * s / whole:.0f} %" for name, s in seconds if s >= LEAST_SHARE * whole]
    return f"Limited, in shares of its time, by: {', '.join(parts)}." if parts else ""


PROBE_STEP_MM = 0.01
PATH_SHARE = 0.9  # of the carriages' limits, that a path may use: the command needs more than its path
CORNER_VELOCITY_PER_UM = 2.4  # mm/s of square corner velocity for each µm of the bound,
CORNER_VELOCITY_RANGE = (5.0, 60.0)  # at least and at most


@dataclass(frozen=True, slots=True)
class RaisedLimits:
    """n moves with their highest limits, and which of them keep the slicer's."""

    moves: Moves
    kept: BoolArray  # (n,)
    bound_mm: FloatArray  # (n,)
    at_flow: BoolArray  # (n,) the nozzle's flow is what their speed is limited by

    def part(self, part: slice) -> RaisedLimits:
        """Return some of the moves."""
        return RaisedLimits(some(self.moves, part), self.kept[part], self.bound_mm[part], self.at_flow[part])


def raised_limits(
    moves: Moves, labels: Labels, kept: BoolArray, bound: Bound, machine: Machine, limits: PlannerLimits
) -> RaisedLimits:
    """Open the limits of all moves that need not keep the slicer's motion.

    kept : (n,) those that keep it whatever they are
    """
    lines, errors_mm = lines_of(moves), bound.errors_mm(labels)
    filament = lines.direction[:, 3]
    kept = kept | bound.keeps(labels) | ~lines.travels | (filament < 0.0)
    # how far the carriage that goes farthest goes for a mm of each move, at the worse of its ends
    gain = np.max(_carriage_gains(moves, lines.direction[:, :3], machine), axis=0)
    fastest = bound.max_speed_mm_per_s or limits.velocity_mm_per_s
    velocity = float(np.min(machine.limits.carriage_velocity_mm_per_s))
    speed = np.minimum(fastest, PATH_SHARE * velocity / gain)
    flowing = lines.travels & (filament > 0.0)
    if bound.max_flow_mm3_per_s is None:
        fastest_filament = float((moves.speed * filament)[flowing].max(initial=0.0))
    else:
        fastest_filament = bound.max_flow_mm3_per_s / (0.25 * np.pi * FILAMENT_MM**2)
    by_flow = np.full(len(moves), np.inf)
    by_flow[flowing] = fastest_filament / filament[flowing]
    at_flow = by_flow < speed
    speed = np.minimum(speed, by_flow)
    corner = np.clip(CORNER_VELOCITY_PER_UM * 1e3 * errors_mm, *CORNER_VELOCITY_RANGE)
    quickest = replace(
        moves,
        speed=np.where(flowing, speed, np.maximum(speed, moves.speed)),
        velocity_limit=np.full(len(moves), fastest),
        acceleration=PATH_SHARE * machine.limits.carriage_acceleration_mm_per_s2 / gain,
        square_corner_velocity=corner,
        minimum_cruise_ratio=np.zeros(len(moves)),
    )
    return RaisedLimits(selected_limits(quickest, moves, ~kept), kept, errors_mm, at_flow & ~kept)


def selected_limits(ones: Moves, others: Moves, which: BoolArray) -> Moves:
    """Return (n,) limits, from `ones` where `which` is true, else from the others."""
    names = ("speed", "velocity_limit", "acceleration", "square_corner_velocity", "minimum_cruise_ratio")
    return replace(others, **{name: np.where(which, getattr(ones, name), getattr(others, name)) for name in names})


def slowed(moves: Moves, share: FloatArray, speed: FloatArray) -> Moves:
    """Scale time by shares (n,) below one: speed v → s v, of speeds (n,) mm/s, acceleration a → s² a."""
    less = share < 1.0
    return replace(
        moves,
        speed=np.where(less, speed * share, moves.speed),
        acceleration=np.where(less, moves.acceleration * share**2, moves.acceleration),
        square_corner_velocity=np.where(less, moves.square_corner_velocity * share, moves.square_corner_velocity),
    )


def least_carriage_gain(moves: Moves, machine: Machine) -> FloatArray:
    """Return how far the farthest carriage goes for a mm of each move, (n,), where that is least of three places."""
    direction = lines_of(moves).direction[:, :3]
    middle = 0.5 * (moves.start + moves.end)[:, :3]
    return np.asarray(np.min(_carriage_gains(moves, direction, machine, middle), axis=0))


def _carriage_gains(moves: Moves, direction: FloatArray, machine: Machine, *more: FloatArray) -> list[FloatArray]:
    carriages = machine.kinematics.compiled().inverse
    places = (moves.start[:, :3], moves.end[:, :3] - PROBE_STEP_MM * direction, *more)
    rates = (
        np.abs(carriages(np.ascontiguousarray(at + PROBE_STEP_MM * direction)) - carriages(np.ascontiguousarray(at)))
        for at in places
    )
    return [np.maximum(np.max(rate, axis=1) / PROBE_STEP_MM, 0.5) for rate in rates]
