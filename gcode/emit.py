"""Toolhead motion → `G1` lines: few bytes, no jumps, and no error that adds up.

XYZ have up to four decimals (three double Klipper's cost of a short segment), E five, F three. A number is rounded to a
whole count of its last decimal or, where the move has slack, to the fewest digits within the slack. Words whose count
has not changed are left out. Relative numbers are differences of counts, so rounding errors never add up. The text is
written by compiled functions, many lines at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gcode.program import ByteArray, FloatArray, IntArray, ModalState
from models.compiled import kernel

Place = tuple[float, float, float, float]  # of X Y Z E

XYZ_DECIMALS, E_DECIMALS, F_DECIMALS = 4, 5, 3
E_SLACK_MM = 5e-5  # filament, where a move has any slack: a fortieth of a step
LATE_S = 2e-5  # at most, where a move has any slack
LONGEST_LINE = 128  # bytes: five words of a 64-bit count each, with sign and point, are 118
_LETTERS = np.frombuffer(b"XYZEF", dtype=np.uint8)
_DECIMALS = np.array([XYZ_DECIMALS] * 3 + [E_DECIMALS, F_DECIMALS])
_SPACE, _MINUS, _POINT, _ZERO, _NEWLINE, _G = b" -.0\nG"


@kernel
def write_moves(
    xyz: FloatArray, e: FloatArray, speed: FloatArray, lasting: FloatArray, slack: FloatArray,
    base: Place, per_mm: Place, f_counts: float, relative: tuple[bool, bool],
    state: IntArray, last: FloatArray, stated: FloatArray, out: ByteArray,
) -> IntArray:  # fmt: skip
    """Write n `G1` lines one after the other; returns where each one ends in `out`, (n,) bytes.

    Parameters
    ----------
    xyz : (n, 3) mm;  e : (n,) mm of filament;  speed : (n,) mm/s;  lasting : (n,) s
    slack : (n,) mm, position error that a move may have at its end and, from its timing, on the way; 0: last decimal
    base : mm, subtracted from X Y Z E;  per_mm : counts of the last decimal in a mm
    f_counts : counts of F's last decimal in a mm/s
    relative : whether X Y Z are differences, and whether E is
    state : (5,) counts of X Y Z E F that the firmware has; updated
    last : (4,) X Y Z, mm, exact end of the last move, and how late it ends, s; updated
    stated : (n, 3) X Y Z, mm, end of each move after rounding; filled in
    out : (at least n LONGEST_LINE,) bytes
    """
    ends = np.empty(len(e), dtype=np.int64)
    now = np.empty(4, dtype=np.int64)
    at = np.int64(0)
    for k in range(len(e)):
        if not np.isfinite(xyz[k].sum() + e[k] + speed[k]):
            raise ValueError("A move to or at a number that is not finite cannot be written.")
        for i in range(3):
            now[i] = _short((xyz[k, i] - base[i]) * per_mm[i], state[i], slack[k] * per_mm[i], relative[0])
        filament = E_SLACK_MM * per_mm[3] if slack[k] > 0.0 else 0.0
        now[3] = _short((e[k] - base[3]) * per_mm[3], state[3], filament, relative[1])
        if now[0] != state[0] or now[1] != state[1] or now[2] != state[2] or now[3] != state[3]:
            feed = _feed(xyz[k], now, speed[k], lasting[k], slack[k], per_mm, f_counts, state, last)
            at = _write_move(now, feed, relative, state, out, at)
        for i in range(3):
            last[i] = xyz[k, i]
            stated[k, i] = state[i] / per_mm[i] + base[i]
        ends[k] = at
    return ends


@kernel
def _short(counts: float, before: np.int64, slack: float, relative: bool) -> np.int64:
    """Round to the number with the fewest digits within the slack, in counts; prefer the one that the firmware has."""
    nearest = np.int64(np.rint(counts))
    if slack < 1.0:
        return nearest
    if abs(counts - before) <= slack:
        return before
    origin = before if relative else np.int64(0)
    coarse = np.int64(10)
    while coarse <= 2.0 * slack:
        coarse *= 10
    while coarse > 1:
        rounded = np.int64(np.rint((counts - origin) / coarse)) * coarse + origin
        if abs(counts - rounded) <= slack:
            return rounded
        coarse //= 10
    return nearest


@kernel
def _feed(
    to: FloatArray, now: IntArray, speed: float, lasting: float, slack: float,
    per_mm: Place, f_counts: float, state: IntArray, last: FloatArray,
) -> np.int64:  # fmt: skip
    """Choose F: the last one if the move then ends in time, or else the one with the fewest digits.

    The next move corrects a move's timing error, so time does not drift.
    """
    demanded, written = 0.0, 0.0
    for i in range(3):
        demanded += (to[i] - last[i]) ** 2
        written += ((now[i] - state[i]) / per_mm[i]) ** 2
    if lasting > 0.0 and demanded > 0.0 and written > 0.0:
        speed *= np.sqrt(written / demanded)
    elif lasting > 0.0 and speed <= 0.0:  # filament alone, or what rounding has left to go
        speed = (np.sqrt(written) if written > 0.0 else abs(now[3] - state[3]) / per_mm[3]) / lasting
    if slack <= 0.0 or demanded <= 0.0 or written <= 0.0 or speed <= 0.0:
        last[3] = 0.0
        return np.int64(np.rint(speed * f_counts))
    late, may_be = last[3], min(slack / speed, LATE_S)
    due = speed * lasting * f_counts  # F of a move that takes 1 s
    low, high = due / (lasting - late + may_be), due / max(lasting - late - may_be, 1e-9)
    feed = state[4]
    if not low <= feed <= high:
        ideal = due / (lasting - late)
        coarse = np.int64(10**9)
        while coarse > 1:
            feed = np.int64(np.rint(ideal / coarse)) * coarse
            if low <= feed <= high:
                break
            coarse //= 10
        if coarse == 1:
            feed = np.int64(np.rint(ideal))
    last[3] = late + due / max(feed, 1) - lasting
    return feed


@kernel
def _write_move(
    now: IntArray, feed: np.int64, relative: tuple[bool, bool], state: IntArray, out: ByteArray, at: int
) -> int:
    """One line with the words that have changed; returns where the next one begins."""
    out[at], out[at + 1] = _G, _ZERO + 1
    at += 2
    for i in range(4):
        if now[i] != state[i]:
            differs = relative[0] if i < 3 else relative[1]
            counts = now[i] - state[i] if differs else now[i]
            at = _write_word(_LETTERS[i], counts, _DECIMALS[i], out, at)
            state[i] = now[i]
    if feed != state[4]:
        at = _write_word(_LETTERS[4], max(feed, np.int64(1)), _DECIMALS[4], out, at)  # F0 would be an error
        state[4] = feed
    out[at] = _NEWLINE
    return at + 1


@kernel
def _write_word(letter: int, counts: np.int64, decimals: int, out: ByteArray, at: int) -> int:
    """Write a letter and counts / 10^decimals in as few digits as it takes."""
    out[at], out[at + 1] = _SPACE, letter
    at += 2
    if counts < 0:
        out[at] = _MINUS
        at += 1
        counts = -counts
    while decimals > 0 and counts % 10 == 0:
        counts //= 10
        decimals -= 1
    digits, more = 1, counts // 10
    while more > 0:
        digits += 1
        more //= 10
    digits = max(digits, decimals)  # 5 counts of four decimals are .0005
    end = at + digits + (1 if decimals > 0 else 0)
    place = end - 1
    for digit in range(digits):
        if digit == decimals and decimals > 0:
            out[place] = _POINT
            place -= 1
        out[place] = _ZERO + counts % 10
        counts //= 10
        place -= 1
    if digits == decimals:
        out[place] = _POINT
    return end


XYZ_COUNTS, E_COUNTS, F_COUNTS = 10**XYZ_DECIMALS, 10**E_DECIMALS, 10**F_DECIMALS  # per unit of the file


class MoveWriter:
    """Writes moves in the frame of the file. Call `reset` first, and after every line that is not ours."""

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
        self._begin = counts[3], e  # of E, counts and mm
        self._last = np.array([*xyz, 0.0])  # X Y Z of the last move, mm, and how late its end is, s

    @property
    def place(self) -> tuple[float, ...]:
        """Position after the lines written so far, X Y Z E in mm. Pass it to `reset` to keep the rounding."""
        counts, (count, mm) = self._state.tolist(), self._begin
        x, y, z, e = (counts[i] / self._per_mm[i] + self._base[i] for i in range(4))
        return x, y, z, mm if counts[3] == count else e  # nothing written: no digits to keep

    def here(self, speed: float) -> list[bytes]:
        """Lines that state the known position, none in relative mode. A toolhead elsewhere moves in XY, then down."""
        if self._relative[0]:
            return []
        x, y, z = (b"%.4f" % (count / XYZ_COUNTS) for count in self._state[:3])
        over = b"G1 X%b Y%b F%.3f\n" % (x, y, max(speed * self._f_counts / F_COUNTS, 1e-3))
        return [over] if self._holds_z else [over, b"G1 Z%b\n" % z]

    def move(self, x: float, y: float, z: float, e: float, speed: float) -> bytes:
        """One line to this place (mm) at `speed` mm/s; empty when nothing moves by a count."""
        return self.block(np.array([[x, y, z]]), np.array([e]), np.array([speed]))[0]

    def moves(self, points: FloatArray, speeds: FloatArray) -> list[bytes]:
        """Many lines at once; lines without a change are left out.

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
        """Return many lines as one text, and (n,) bytes, where each one ends; a line without a change is empty.

        Parameters
        ----------
        xyz : (n, 3) mm;  e : (n,) mm of filament;  speeds : (n,) mm/s
        lasting : (n,) s, how long each is to take at that speed; needed with a slack
        slack : (n,) mm, position error that a move may have at its end and on the way, if that saves digits or words;
            0, the default: the last decimal
        stated : (n, 3) mm, filled in with the ends of the moves after rounding
        """
        if self._holds_z:  # an unknown height is not written
            xyz = np.column_stack([xyz[:, :2], np.full(len(xyz), self.place[2])])
        none = np.zeros(len(e))
        given = xyz, e, speeds, none if lasting is None else lasting, none if slack is None else slack
        form = self._base, self._per_mm, self._f_counts, self._relative
        stated = np.empty((len(e), 3)) if stated is None else stated
        out = np.empty(len(e) * LONGEST_LINE, dtype=np.uint8)
        ends = write_moves(*map(np.ascontiguousarray, given), *form, self._state, self._last, stated, out)
        return out[: ends[-1]].tobytes() if len(ends) else b"", ends
