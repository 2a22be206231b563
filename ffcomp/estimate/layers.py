"""Count layers as the slicer's comments number them; without such comments, the heights at which plastic flows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from gcode.layers import FEW_MOVES, SLOPE_MM
from models.arrays import BoolArray, FloatArray, IntArray

BEFORE = -1  # what comes before the first layer
_STEP_MM = 1e-3  # in which heights are counted: so a spiral vase has only so many
_NOWHERE = -(1 << 40)  # the height before anything is extruded


@dataclass(frozen=True, slots=True)
class Layer:
    """Time and filament of a layer, or of a height."""

    row: FloatArray  # (6,), see `ffcomp.estimate.statistics`
    line: int  # its first, from 1
    z_mm: float = -np.inf  # of its highest extruding move; -inf: none extrudes
    extruding: int = 0  # moves

    def with_more(self, other: Layer) -> Layer:
        """Add another part of the same layer."""
        return Layer(
            self.row + other.row,
            min(self.line, other.line),
            max(self.z_mm, other.z_mm),
            self.extruding + other.extruding,
        )


@dataclass(slots=True)
class Layers:
    """Layers that have been counted so far."""

    number: int = BEFORE  # of the layer at the end of what has been counted
    _numbered: dict[int, Layer] = field(default_factory=dict)
    _heights: dict[int, Layer] = field(default_factory=dict)  # as long as no comment has begun a layer
    _height: int = _NOWHERE  # of the last extruding move

    def leave(self, begun: int) -> None:
        """End a slice in which so many layers have begun."""
        self.number += begun

    def wait(self, begun: int, row: FloatArray, line: int) -> None:
        """Count a wait, when `begun` layers of the slice have begun."""
        number = self.number + begun
        if number > BEFORE:
            _put(self._numbered, number, Layer(row, line))
        else:
            _put(self._heights, self._height, Layer(row, line))

    def add(self, begun: IntArray, rows: FloatArray, z: FloatArray, extrudes: BoolArray, line: IntArray) -> None:
        """Count n moves.

        Parameters
        ----------
        begun : (n,) array
            Layers of the slice that have begun before each.
        rows : (n, 6) array
        z : (n,) array
            Where each ends, mm.
        extrudes : (n,) array
        line : (n,) array
            In the file, from 1.
        """
        number, height = self.number + begun, self._heights_of(z, extrudes)
        numbered = number > BEFORE
        tops = np.where(extrudes, z, -np.inf)
        for into, key, own in ((self._numbered, number, numbered), (self._heights, height, ~numbered)):
            for k, layer in _layers(key[own], rows[own], tops[own], line[own]):
                _put(into, k, layer)

    def _heights_of(self, z: FloatArray, extrudes: BoolArray) -> IntArray:
        """Return the height of the last extruding move, (n,)."""
        last = np.maximum.accumulate(np.where(extrudes, np.arange(len(z)), -1))
        height = np.where(last >= 0, np.rint(z[np.maximum(last, 0)] / _STEP_MM).astype(np.int64), self._height)
        self._height = int(height[-1])
        return height

    def in_order(self) -> list[tuple[int, Layer]]:
        """Return the layers with their numbers, from 0; BEFORE, if anything comes before the first."""
        if self._numbered:
            before = [(BEFORE, _together(self._heights.values()))] if self._heights else []
            return before + sorted(self._numbered.items())
        heights = dict(sorted(self._heights.items()))
        start = heights.pop(_NOWHERE, None)
        layers = list(heights.values())
        if sum(layer.extruding for layer in layers) < FEW_MOVES * len(layers):
            layers = _banded(heights)
        return ([] if start is None else [(BEFORE, start)]) + list(enumerate(layers))


def _put(layers: dict[int, Layer], key: int, layer: Layer) -> None:
    layers[key] = layers[key].with_more(layer) if key in layers else layer


def _together(layers: Iterable[Layer]) -> Layer:
    first, *others = layers
    for other in others:
        first = first.with_more(other)
    return first


def _banded(heights: dict[int, Layer]) -> list[Layer]:
    """Cut a slope, on which every move has its own height, into layers."""
    bands: dict[int, Layer] = {}
    for height, layer in heights.items():
        _put(bands, height // round(SLOPE_MM / _STEP_MM), layer)
    return list(bands.values())


def _layers(keys: IntArray, rows: FloatArray, tops: FloatArray, line: IntArray) -> Iterator[tuple[int, Layer]]:
    """Yield layers of moves by their key. tops : (n,) mm, -inf where nothing is extruded."""
    flows = np.isfinite(tops)
    for key, row, first in summed(keys, np.column_stack([rows, flows])):
        yield key, Layer(row[:-1], int(line[first]), float(tops[keys == key].max()), round(float(row[-1])))


def summed(keys: IntArray, rows: FloatArray) -> Iterator[tuple[int, FloatArray, int]]:
    """Yield each key once, with its rows' sum and the index of the first. keys : (n,), rows : (n, m)."""
    unique, first, which = np.unique(keys, return_index=True, return_inverse=True)
    sums = [np.bincount(which, column, minlength=len(unique)) for column in rows.T]
    yield from zip(unique.tolist(), np.stack(sums, axis=1), first.tolist(), strict=True)
