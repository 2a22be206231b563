"""Shape a motion that is sampled evenly: exact but where the acceleration jumps, and quick enough for a search.

A search samples the plan once and tries many shapers on it; `apply` asks the plan anew at every pulse's own times.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from ffcomp.shapers.kinds import SHAPERS
from ffcomp.shapers.pulses import DAMPING_RATIO, Shaper
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


def shape_samples_by_frequency(
    samples: FloatArray, frequency_hz: FloatArray, kind: str, step_s: float, margin: int
) -> FloatArray:
    """Return the samples (margin + n + margin, 3), shaped in x and y with the frequencies (n, 2) of each moment.

    As `apply.scheduled_shape` does, on an even grid: (n, 3).
    """
    in_periods = SHAPERS[kind](1.0, DAMPING_RATIO)
    out = samples[margin : len(samples) - margin].copy()
    for axis in range(2):
        delays = 1.0 / (frequency_hz[:, axis] * step_s)
        out[:, axis] = _delayed(
            np.ascontiguousarray(samples[:, axis]), delays, in_periods.amplitude, in_periods.time, margin
        )
    return out


@njit(cache=True, nogil=True)
def _delayed(
    column: FloatArray, period_steps: FloatArray, amplitude: FloatArray, periods: FloatArray, margin: int
) -> FloatArray:
    """Sum the pulses' delayed values, each from the parabola through the three samples that are nearest."""
    out = np.zeros(len(period_steps))
    last = len(column) - 2
    for k in range(len(out)):
        for j in range(len(amplitude)):
            at = margin + k - periods[j] * period_steps[k]
            i = min(max(int(np.rint(at)), 1), last)
            off = min(max(at - i, -1.0), 1.0)
            bend = 0.5 * (column[i + 1] - 2.0 * column[i] + column[i - 1])
            out[k] += amplitude[j] * (column[i] + off * (0.5 * (column[i + 1] - column[i - 1]) + off * bend))
    return out
