"""Shape a motion that is sampled evenly: exact but where the acceleration jumps, and quick enough for a search."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffcomp.shapers.pulses import Shaper
from models.arrays import FloatArray


def shape_samples(samples: FloatArray, by_column: Sequence[Shaper | None], step_s: float, margin: int) -> FloatArray:
    """Return the shaped columns (n, m) of samples (margin + n + margin, m) that are step_s apart.

    The margins hold the motion before and after; what reaches beyond them stays where it is there.
    """
    columns = []
    for column, shaper in zip(samples.T, by_column, strict=True):
        if shaper is None:
            columns.append(column[margin : len(column) - margin])
            continue
        first, weights = on_grid(shaper, step_s)
        before, after = max(0, first + len(weights) - 1 - margin), max(0, -first - margin)
        padded = np.pad(column, (before, after), mode="edge")
        shaped = np.convolve(padded, weights, mode="valid")
        begin = before + margin - (first + len(weights) - 1)
        columns.append(shaped[begin : begin + len(column) - 2 * margin])
    return np.stack(columns, axis=1)


def on_grid(shaper: Shaper, step_s: float) -> tuple[int, FloatArray]:
    """Return the delay of the first weight, in steps, and the weights of a shaper on an even grid.

    Each pulse becomes three, which do to a parabola what it does.
    """
    at = shaper.time / step_s
    middle = np.rint(at).astype(np.int64)
    off = at - middle
    first = int(middle.min()) - 1
    weights = np.zeros(int(middle.max()) + 2 - first)
    for shift, share in ((-1, (off**2 - off) / 2), (0, 1 - off**2), (1, (off**2 + off) / 2)):
        np.add.at(weights, middle + shift - first, shaper.amplitude * share)
    return first, weights
