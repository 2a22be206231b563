"""Bring sample times to one uniform clock: missing rows become gaps, jitter is interpolated away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from models.arrays import FloatArray, IntArray

LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 800.0, 25600.0
SHORTEST_S = 0.5
_UNITS = {"ms": 1e3, "µs": 1e6, "ns": 1e9}  # in a second
_LARGEST_JITTER = 0.25  # of a sample period: beyond it, which sample is missing is a guess
_NEGLIGIBLE_JITTER = 0.01  # of a sample period: 0.5° of phase at 200 Hz and 1600 Hz sampling


class Uniform:
    """Samples at a constant rate."""

    time_s: FloatArray  # (n,) s, uniform

    @property
    def sample_rate_hz(self) -> float:
        """Mean sample rate."""
        return float((len(self.time_s) - 1) / (self.time_s[-1] - self.time_s[0]))


@dataclass(frozen=True, eq=False)
class Clock:
    """A uniform grid of n times and where the file's rows fall on it."""

    start_s: float
    period_s: float
    index: IntArray  # (rows,) the grid point next to each row
    time_s: FloatArray  # (rows,) when the rows were really taken

    @property
    def count(self) -> int:
        """Number of grid points."""
        return int(self.index[-1]) + 1

    @property
    def grid_s(self) -> FloatArray:
        """(n,) s."""
        return np.asarray(self.start_s + self.period_s * np.arange(self.count), dtype=np.float64)

    def on_grid(self, values: FloatArray) -> FloatArray:
        """Resample rows (rows,) to the grid (n,); gaps are NaN in both.

        Where the rows do not fall on the grid, a cubic spline through the rows takes them there; a grid point is
        a gap when its own row is missing.
        """
        out = np.full(self.count, np.nan)
        taken = np.isfinite(values)
        at = self.index[taken]
        jitter = np.abs(self.time_s - self.grid_s[self.index]).max() / self.period_s
        if jitter <= _NEGLIGIBLE_JITTER or taken.sum() < 4:
            out[at] = values[taken]
        else:
            out[at] = CubicSpline(self.time_s[taken], values[taken])(self.grid_s[at])
        return out


def clock_of(
    time_s: FloatArray, row: IntArray, lowest_rate_hz: float = LOWEST_RATE_HZ
) -> tuple[Clock | None, list[str]]:
    """Return the clock of rows taken at these times (rows,), or the problems with them, in full sentences.

    The period is the median interval, refined by a straight line through all the times.
    """
    problems = _falling(time_s, row)
    if problems:
        return None, problems
    steps = np.diff(time_s)
    median = float(np.median(steps))
    problems = _bad_rate(median, len(time_s), float(time_s[-1] - time_s[0]), lowest_rate_hz) + _uneven(
        steps / median, time_s, row
    )
    if problems:
        return None, problems
    index = np.concatenate([[0], np.cumsum(np.rint(steps / median))]).astype(np.int64)
    period, start = np.polyfit(index, time_s, 1)
    return Clock(float(start), float(period), index, time_s), []


def _falling(time_s: FloatArray, row: IntArray) -> list[str]:
    if len(time_s) < 2:
        return [f"A recording needs at least two rows with a time, but there are {len(time_s)}."]
    back = np.flatnonzero(np.diff(time_s) <= 0)
    if not len(back):
        return []
    k = back[0]
    return [
        f"The time must rise from row to row, but column t_s goes from {time_s[k]:.9g} s to {time_s[k + 1]:.9g} s "
        f"at row {row[k + 1]} ({len(back)} such rows)."
    ]


def _bad_rate(period_s: float, count: int, length_s: float, lowest_hz: float) -> list[str]:
    problems = []
    rate = 1.0 / period_s
    faster = " Record with a faster sensor: an accelerometer on the printer's own board." if rate < lowest_hz else ""
    if not lowest_hz * 0.99 <= rate <= HIGHEST_RATE_HZ * 1.01:
        problems.append(
            f"The sample rate in column t_s is {rate:.6g} Hz; it must lie between {lowest_hz:g} and "
            f"{HIGHEST_RATE_HZ:g} Hz.{_other_unit(rate) or faster}"
        )
    if length_s + period_s < SHORTEST_S:
        problems.append(
            f"The recording is {length_s:.4g} s long ({count} rows); it must last at least {SHORTEST_S:g} s, "
            "for what moves rings on for 0.2 s and more."
        )
    return problems


def _other_unit(rate_hz: float) -> str:
    """Name the unit that would make the rate plausible, in a sentence; '' if none."""
    for unit, per_second in _UNITS.items():
        if LOWEST_RATE_HZ * 0.999 <= rate_hz * per_second <= HIGHEST_RATE_HZ * 1.001:
            return f" It looks as if the time were in {unit}, not in s: multiply it by {1 / per_second:g}."
    return ""


def _uneven(periods: FloatArray, time_s: FloatArray, row: IntArray) -> list[str]:
    """Check intervals in sample periods, (rows - 1,)."""
    off: NDArray[np.int64] = np.flatnonzero(np.abs(periods - np.rint(periods)) > _LARGEST_JITTER)
    off = np.union1d(off, np.flatnonzero(periods < 1 - _LARGEST_JITTER))
    if not len(off):
        return []
    k = off[0]
    return [
        f"The rate must be nearly constant (each interval within {_LARGEST_JITTER:.0%} of a sample period of a whole "
        f"number of them), but column t_s steps by {periods[k]:.5g} periods at row {row[k + 1]}, t = "
        f"{time_s[k + 1]:.9g} s ({len(off)} such rows). "
        "Record with a sensor whose rows are dated by its own clock, or is read without a pause."
    ]


def fill_gaps(values: FloatArray) -> FloatArray:
    """Bridge missing samples by straight lines: (n,) -> (n,)."""
    known = np.isfinite(values)
    t = np.arange(len(values))
    return values if known.all() else np.interp(t, t[known], values[known])
