"""Toolhead motion → `G1` lines: few bytes, no jumps, and no error that adds up.

XYZ have four decimals (three double Klipper's cost per segment), E five, F three. A number is rounded to a
whole count of its last decimal; what has not changed in counts is left out, and relative numbers are
differences of counts, so their sum never strays from the truth by more than half a count.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gcode.emit_kernels import E_DECIMALS, F_DECIMALS, LONGEST_LINE, XYZ_DECIMALS, write_moves
from gcode.program import Frame

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

XYZ_COUNTS, E_COUNTS, F_COUNTS = 10**XYZ_DECIMALS, 10**E_DECIMALS, 10**F_DECIMALS  # per unit of the file


class MoveWriter:
    """Writes moves in the frame of the file. `reset` first, and after every line that is not ours."""

    def __init__(self) -> None:
        self.reset(Frame(), (0.0, 0.0, 0.0), 0.0)

    def reset(self, frame: Frame, xyz: Sequence[float], e: float) -> None:
        """The firmware is in this state: toolhead at `xyz`, filament at `e`, mm. The next move says F."""
        unit, unit_e = frame.unit_mm, frame.unit_mm * frame.flow
        per_mm = (XYZ_COUNTS / unit, XYZ_COUNTS / unit, XYZ_COUNTS / unit, E_COUNTS / unit_e)
        self._f_counts = 60 * F_COUNTS / frame.feed_factor / unit
        self._relative = not frame.absolute, not frame.absolute_e
        counts = [round((at - base) * per) for at, base, per in zip((*xyz, e), frame.base, per_mm, strict=True)]
        self._state = np.array([*counts, -1], dtype=np.int64)  # of X Y Z E F; F has none yet
        self._base, self._per_mm = np.array(frame.base), np.array(per_mm)

    @property
    def place(self) -> tuple[float, ...]:
        """Where the lines written so far have the toolhead: X Y Z E, mm. Given to `reset`, no rounding is lost."""
        return tuple((self._state[:4] / self._per_mm + self._base).tolist())

    def move(self, x: float, y: float, z: float, e: float, speed: float) -> bytes:
        """One line to this place (mm) at `speed` mm/s; empty when nothing moves by a count."""
        return self.block(np.array([[x, y, z]]), np.array([e]), np.array([speed]))[0]

    def moves(self, points: FloatArray, speeds: FloatArray) -> list[bytes]:
        """Many lines at once; those that say nothing are left out.

        points : (n, 4) mm, columns X Y Z E;  speeds : (n,) mm/s
        """
        return self.block(points[:, :3], points[:, 3], speeds)[0].splitlines(keepends=True)

    def block(self, xyz: FloatArray, e: FloatArray, speeds: FloatArray) -> tuple[bytes, IntArray]:
        """Many lines in one piece, and where each ends in it, (n,) bytes; a line that says nothing is empty.

        xyz : (n, 3) mm;  e : (n,) mm of filament;  speeds : (n,) mm/s
        """
        out = np.empty(len(e) * LONGEST_LINE, dtype=np.uint8)
        ends = write_moves(
            np.ascontiguousarray(xyz),
            np.ascontiguousarray(e),
            np.ascontiguousarray(speeds),
            self._base,
            self._per_mm,
            self._f_counts,
            self._relative,
            self._state,
            out,
        )
        return out[: ends[-1]].tobytes() if len(ends) else b"", ends
