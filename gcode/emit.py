"""Toolhead motion → `G1` lines: few bytes, no jumps, and no error that adds up.

XYZ have four decimals (three double Klipper's cost per segment), E five, F three. A number is rounded to a
whole count of its last decimal; what has not changed in counts is left out, and relative numbers are
differences of counts, so their sum never strays from the truth by more than half a count.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gcode.program import Frame

FloatArray = NDArray[np.float64]

XYZ_COUNTS, E_COUNTS, F_COUNTS = 10_000, 100_000, 1_000  # per unit of the file


class MoveWriter:
    """Writes moves in the frame of the file. `reset` first, and after every line that is not ours."""

    def __init__(self) -> None:
        self.reset(Frame(), (0.0, 0.0, 0.0), 0.0)

    def reset(self, frame: Frame, xyz: Sequence[float], e: float) -> None:
        """The firmware is in this state: toolhead at `xyz`, filament at `e`, mm. The next move says F."""
        unit, unit_e = frame.unit_mm, frame.unit_mm * frame.flow
        self._base = frame.base
        self._per_mm = (XYZ_COUNTS / unit, XYZ_COUNTS / unit, XYZ_COUNTS / unit, E_COUNTS / unit_e)
        self._f_counts = 60 * F_COUNTS / frame.feed_factor / unit
        self._absolute, self._absolute_e = frame.absolute, frame.absolute_e
        x, y, z = xyz
        self._last = self._counts(x, y, z, e)
        self._last_f = -1

    @property
    def place(self) -> tuple[float, ...]:
        """Where the lines written so far have the toolhead: X Y Z E, mm. Given to `reset`, no rounding is lost."""
        return tuple(n / per + b for n, per, b in zip(self._last, self._per_mm, self._base, strict=True))

    def _counts(self, x: float, y: float, z: float, e: float) -> tuple[int, int, int, int]:
        (base_x, base_y, base_z, base_e), (per_x, per_y, per_z, per_e) = self._base, self._per_mm
        return (
            round((x - base_x) * per_x),
            round((y - base_y) * per_y),
            round((z - base_z) * per_z),
            round((e - base_e) * per_e),
        )

    def move(self, x: float, y: float, z: float, e: float, speed: float) -> bytes:
        """One line to this place (mm) at `speed` mm/s; empty when nothing moves by a count."""
        return self._write(*self._counts(x, y, z, e), round(speed * self._f_counts))

    def moves(self, points: FloatArray, speeds: FloatArray) -> list[bytes]:
        """Many lines at once; those that say nothing are left out.

        points : (n, 4) mm, columns X Y Z E;  speeds : (n,) mm/s
        """
        counts = np.rint((points - self._base) * self._per_mm).astype(np.int64)
        feeds = np.rint(speeds * self._f_counts).astype(np.int64)
        written = map(self._write, *counts.T.tolist(), feeds.tolist())
        return [line for line in written if line]

    def _write(self, x: int, y: int, z: int, e: int, f: int) -> bytes:
        last_x, last_y, last_z, last_e = self._last
        from_x, from_y, from_z = (0, 0, 0) if self._absolute else (last_x, last_y, last_z)
        line = b"G1"
        if x != last_x:
            line += b" X%.10g" % ((x - from_x) / XYZ_COUNTS)
        if y != last_y:
            line += b" Y%.10g" % ((y - from_y) / XYZ_COUNTS)
        if z != last_z:
            line += b" Z%.10g" % ((z - from_z) / XYZ_COUNTS)
        if e != last_e:
            line += b" E" + _plain(e if self._absolute_e else e - last_e)
        if line == b"G1":
            return b""
        self._last = x, y, z, e
        if f != self._last_f:
            self._last_f = f
            line += b" F%.10g" % (max(f, 1) / F_COUNTS)  # F0 would be an error
        return line + b"\n"


def _plain(counts: int) -> bytes:
    """E without an exponent, which %g uses below 0.0001."""
    text = b"%.12g" % (counts / E_COUNTS)
    return text if b"e" not in text else (b"%.5f" % (counts / E_COUNTS)).rstrip(b"0")
