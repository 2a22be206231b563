"""Toolhead motion → `G1` lines: few bytes, no jumps, and no error that adds up.

XYZ have up to four decimals (three double Klipper's cost of a short segment), E five, F three. A number is rounded to a
whole count of its last decimal, or, where the move has slack, to the fewest digits within it. What has not changed in
counts is left out, and relative numbers are differences of counts, so their sum never strays from the truth by more
than that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gcode.arrays import FloatArray, IntArray
from gcode.emit_kernels import E_DECIMALS, F_DECIMALS, LONGEST_LINE, XYZ_DECIMALS, write_moves
from gcode.program import ModalState

XYZ_COUNTS, E_COUNTS, F_COUNTS = 10**XYZ_DECIMALS, 10**E_DECIMALS, 10**F_DECIMALS  # per unit of the file


class MoveWriter:
    """Writes moves in the frame of the file. `reset` first, and after every line that is not ours."""

    def __init__(self) -> None:
        self.reset(ModalState(), (0.0, 0.0, 0.0), 0.0)

    def reset(self, frame: ModalState, xyz: Sequence[float], e: float) -> None:
        """Start from this state: toolhead at `xyz`, filament at `e`, mm. The next move says F."""
        unit = frame.unit_mm
        self._per_mm = per_mm = (*[XYZ_COUNTS / unit] * 3, E_COUNTS / (unit * frame.flow))
        self._base = base = frame.base
        self._f_counts = 60 * F_COUNTS / frame.feed_factor / unit
        self._relative = not frame.absolute, not frame.absolute_e
        self._holds_z = frame.absolute and not frame.z_known
        counts = [round((at - base[i]) * per_mm[i]) for i, at in enumerate((*xyz, e))]
        self._state = np.array([*counts, -1], dtype=np.int64)  # of X Y Z E F; F has none yet
        self._given = np.array([*xyz, 0.0])  # X Y Z of the last move, mm, and how late its end is, s

    @property
    def place(self) -> tuple[float, ...]:
        """Where the lines written so far have the toolhead: X Y Z E, mm. Given to `reset`, no rounding is lost."""
        counts = self._state.tolist()
        return tuple(counts[i] / self._per_mm[i] + self._base[i] for i in range(4))

    def here(self, speed: float) -> bytes:
        """One line that states the place itself, but no height that is not known; empty in relative mode.

        Nothing moves, unless somebody has moved the toolhead away and not back.
        """
        if self._relative[0]:
            return b""
        letters = b"XY" if self._holds_z else b"XYZ"
        words = (b" %c%.4f" % (letters[k], self._state[k] / XYZ_COUNTS) for k in range(len(letters)))
        return b"G1%b F%.3f\n" % (b"".join(words), max(speed * self._f_counts / F_COUNTS, 1e-3))

    def move(self, x: float, y: float, z: float, e: float, speed: float) -> bytes:
        """One line to this place (mm) at `speed` mm/s; empty when nothing moves by a count."""
        return self.block(np.array([[x, y, z]]), np.array([e]), np.array([speed]))[0]

    def moves(self, points: FloatArray, speeds: FloatArray) -> list[bytes]:
        """Many lines at once; those that say nothing are left out.

        points : (n, 4) mm, columns X Y Z E;  speeds : (n,) mm/s
        """
        return self.block(points[:, :3], points[:, 3], speeds)[0].splitlines(keepends=True)

    def block(
        self,
        xyz: FloatArray,
        e: FloatArray,
        speeds: FloatArray,
        lasting: FloatArray | None = None,
        slack: FloatArray | None = None,
        stated: FloatArray | None = None,
    ) -> tuple[bytes, IntArray]:
        """Many lines in one piece, and where each ends in it, (n,) bytes; a line that says nothing is empty.

        Parameters
        ----------
        xyz : (n, 3) mm;  e : (n,) mm of filament;  speeds : (n,) mm/s
        lasting : (n,) s, how long each is to take at that speed; needed with a slack
        slack : (n,) mm, how far from its place a move may end, and be in between, if that takes fewer digits or words;
            0, the default: as near as the last decimal lets it
        stated : (n, 3) mm, filled in with the places where the moves end as they are written
        """
        if self._holds_z:  # a height that is not known is not written
            xyz = np.column_stack([xyz[:, :2], np.full(len(xyz), self.place[2])])
        none = np.zeros(len(e))
        out = np.empty(len(e) * LONGEST_LINE, dtype=np.uint8)
        ends = write_moves(
            np.ascontiguousarray(xyz),
            np.ascontiguousarray(e),
            np.ascontiguousarray(speeds),
            none if lasting is None else np.ascontiguousarray(lasting),
            none if slack is None else np.ascontiguousarray(slack),
            self._base,
            self._per_mm,
            self._f_counts,
            self._relative,
            self._state,
            self._given,
            np.empty((len(e), 3)) if stated is None else stated,
            out,
        )
        return out[: ends[-1]].tobytes() if len(ends) else b"", ends
