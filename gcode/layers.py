"""Each move's layer and feature, from the slicer's comments."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from gcode.program import BoolArray, IntArray, Program

UNNAMED = "other"
_LAYER = re.compile(rb";\s*(?:LAYER_CHANGE|CHANGE_LAYER|LAYER:\s*-?\d+|layer \d+)\b", re.IGNORECASE)
_FEATURE = re.compile(rb";\s*(?:TYPE:|FEATURE:|feature )\s*(.+?)\s*$", re.IGNORECASE)
# PrusaSlicer and SuperSlicer "External perimeter", Orca and Bambu "Outer wall", Cura "WALL-OUTER", Simplify3D
# "outer perimeter", ideaMaker "OUTER-PERIMETER"
_OUTER_WALL = re.compile(
    r"(external|outer)[ _-]*(perimeter|wall)|wall[ _-]*outer|overhang (perimeter|wall)", re.IGNORECASE
)
FEW_MOVES = 3.0  # with fewer moves per height on average, heights are a slope and not layers
SLOPE_MM = 0.2  # a slope is cut into layers of this height


@dataclass(frozen=True, slots=True)
class Labels:
    """Layer and feature of n moves."""

    layer: IntArray  # (n,) from 0; moves before the first layer count as its own
    feature: IntArray  # (n,) index into `features`
    features: tuple[str, ...]

    @property
    def layers(self) -> int:
        """Return how many layers there are."""
        return int(self.layer.max(initial=-1)) + 1


def is_outer_wall(feature: str) -> bool:
    """Whether a slicer's feature name means an outer wall."""
    return _OUTER_WALL.search(feature) is not None


def outer_walls(labels: Labels) -> BoolArray:
    """Return which of the n moves belong to outer walls."""
    named = np.array([is_outer_wall(name) for name in labels.features], dtype=np.bool_)
    return named[labels.feature]


def labels(program: Program, at_first: str = UNNAMED, before: int = 0) -> Labels:
    """Layers and features of the moves.

    at_first : the feature when the program begins
    before : as of `layers_of`
    """
    named = ((event.move, begins_feature(program.lines[event.line])) for event in program.events)
    begins, names = zip((0, at_first), *((move, name) for move, name in named if name), strict=True)
    features = tuple(dict.fromkeys(names))
    current = np.searchsorted(np.array(begins), np.arange(len(program.moves)), side="right") - 1
    feature = np.array([features.index(name) for name in names], dtype=np.int64)[current]
    return Labels(layers_of(program, before), feature, features)


def layers_of(program: Program, before: int = 0) -> IntArray:
    """Return the moves' layers, (n,) from 0; without layer comments, they are the heights of extruding moves.

    before : layers of the file that have begun before the program
    """
    starts = layer_starts(program)
    if not starts and not before:
        return _by_height(program)
    begun = before + np.searchsorted(starts, np.arange(len(program.moves)), side="right")
    return np.maximum(begun - 1, 0).astype(np.int64)


def begins_layer(line: bytes) -> bool:
    """Whether the line is a comment that starts a layer."""
    return line.startswith(b";") and _LAYER.match(line) is not None


def begins_feature(line: bytes) -> str:
    """Return the feature that a comment starts; empty if it starts none."""
    match = _FEATURE.match(line) if line.startswith(b";") else None
    return match[1].decode("utf-8", "replace") if match else ""


def last_feature(program: Program) -> str:
    """Return the feature in force at the end of the program; empty if unknown."""
    names = (begins_feature(program.lines[event.line]) for event in reversed(program.events))
    return next(filter(None, names), "")


def layer_starts(program: Program) -> list[int]:
    """Return the moves that follow a layer comment."""
    return [event.move for event in program.events if begins_layer(program.lines[event.line])]


def _by_height(program: Program) -> IntArray:
    """Layers by the height of the last extruding move that set a new one."""
    end, start = program.moves.end, program.moves.start
    extrudes = (end[:, 3] > start[:, 3]) & np.any(end[:, :3] != start[:, :3], axis=1)
    height = np.round(end[:, 2], 3)
    heights = np.unique(height[extrudes])
    if not heights.size:
        return np.zeros(len(end), dtype=np.int64)
    if extrudes.sum() < FEW_MOVES * heights.size:
        height = np.floor(height / SLOPE_MM)
        heights = np.unique(height[extrudes])
    known = np.where(extrudes, np.searchsorted(heights, height), -1)
    last = np.maximum.accumulate(np.where(extrudes, np.arange(len(end)), -1))
    return np.where(last >= 0, known[np.maximum(last, 0)], 0).astype(np.int64)
