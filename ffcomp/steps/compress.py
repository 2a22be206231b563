"""Compress steps into rows `interval count add`, as Klipper's `queue_step` has them.

Step k = 1 … count of a row comes k interval + add k (k − 1)/2 ticks after the last step of the row before it.

Every step has a window of time about its exact tick, and a row must pass through all of its steps' windows. With
k i + a k (k − 1)/2 = low … high, step k asks of the interval

    low_k / k − a (k − 1)/2  ≤  i  ≤  high_k / k − a (k − 1)/2

For a given `add` the row is as long as these ranges of i have a whole number in common. If step k ends the row because
its lower bound is above step j's upper one, then whatever row reaches step k has

    a ≥ 2 (low_k / k − high_j / j) / (k − j)

(or ≤, the other way round): each try cuts off one side, and a few tries find the longest row. Greedy, so the number of
rows is not the least possible, but each is as long as it can be.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from models.arrays import IntArray
from models.compiled import kernel

WayArray = NDArray[np.int8]
Rows = tuple[IntArray, NDArray[np.uint16], NDArray[np.int16], WayArray]  # (r,) interval, count, add, direction

MOST_COUNT = 65535  # 16 bits
MOST_ADD = 32767
FAR_TICKS = 3 << 28  # a step after a longer rest is a row of its own: the clock of a board has 32 bits
MOST_TRIES = 32
BATCH_STEPS = 1 << 18  # enough that the steps kept for the next batch (a row, at most 65535) hardly count


@kernel
def _windows(tick: IntArray, before: int, slack: int, spacing: int) -> tuple[IntArray, IntArray]:
    """Return the first and the last tick allowed for each step, (n,) each.

    They lie no more than `slack` from the exact one, no more than a quarter of the way to the neighbour on that side,
    nor so far that pulses come too close.
    """
    low, high = np.empty_like(tick), np.empty_like(tick)
    for k in range(len(tick)):
        gap = tick[k] - (tick[k - 1] if k else before)
        room = min(slack, gap // 4, max(gap - spacing, 0) // 2)
        low[k], high[k] = tick[k] - room, tick[k] + room
        if k:
            high[k - 1] = tick[k - 1] + room
    return low, high


@kernel
def _stretch(tick: IntArray, way: WayArray, first: int, before: int) -> int:
    """Find the end of the steps that may share rows: one way, and no long rest between them or just after the first."""
    if tick[first] - before >= FAR_TICKS:
        return first + 1
    for k in range(first + 1, len(tick)):
        if way[k] != way[first] or tick[k] - tick[k - 1] >= FAR_TICKS:
            return k
    return len(tick)


@kernel
def _try(low: IntArray, high: IntArray, first: int, end: int, last: int, add: int) -> tuple[int, int, int, int, float]:
    """Return how many steps a row with this `add` holds, and the least and the largest interval for that.

    And what other rows that reach the step where this one fails need of their `add`: 1 at least, −1 at most, 0 it did
    not fail; the bound.
    """
    least, most, at_least, at_most = -math.inf, math.inf, 0, 0
    count, shortest, longest = 0, 0, 0
    whole = True
    for k in range(1, end - first + 1):
        bent = add * (k * (k - 1) // 2) + last
        lowest, highest = (low[first + k - 1] - bent) / k, (high[first + k - 1] - bent) / k
        if lowest > most:
            return count, shortest, longest, 1, add + 2.0 * (lowest - most) / (k - at_most)
        if highest < least:
            return count, shortest, longest, -1, add + 2.0 * (highest - least) / (k - at_least)
        if lowest > least:
            least, at_least = lowest, k
        if highest < most:
            most, at_most = highest, k
        if whole:
            from_, to = math.ceil(least), math.floor(most)
            whole = from_ <= to
            if whole:
                count, shortest, longest = k, from_, to
    return count, shortest, longest, 0, 0.0


@kernel
def _row(
    low: IntArray, high: IntArray, tick: IntArray, first: int, end: int, last: int, open_end: bool, guess: int
) -> tuple[int, int, int]:
    """Find the longest row: count, interval, add. Count 0: it may go on after the end of what is known."""
    best, best_add, from_, to = 0, 0, 0, 0
    least, most, add = -MOST_ADD - 1, MOST_ADD, guess
    for _ in range(MOST_TRIES):
        count, shortest, longest, side, bound = _try(low, high, first, end, last, add)
        if side == 0 and open_end:
            return 0, 0, 0
        if count > best:
            best, best_add, from_, to = count, add, shortest, longest
        if side == 0:
            break
        if side > 0:
            least = max(add + 1, math.ceil(min(bound, MOST_ADD + 1.0)))
            beyond = least + min(least - add, (most - least) // 2)
        else:
            most = min(add - 1, math.floor(max(bound, -MOST_ADD - 2.0)))
            beyond = most - min(add - most, (most - least) // 2)
        if least > most:
            break
        add = beyond  # as far past the bound again, but no farther than the middle of what is left
    even = (tick[first + best - 1] - last - best_add * (best * (best - 1) // 2)) / best
    return best, min(max(round(even), from_), to), best_add  # its last step is as exact as can be: the next row's start


@kernel
def _rows(
    tick: IntArray, way: WayArray, state: IntArray, slack: int, spacing: int, known: int
) -> tuple[IntArray, IntArray, IntArray, WayArray, int]:
    """Rows of the first `known` steps (all but one if more may come), and how many steps are in them.

    state : the exact tick and the row's tick of the last step before these, and the last row's `add`; goes on
    """
    low, high = _windows(tick, state[0], slack, spacing)
    more_come = known < len(tick)
    interval, count, add = np.empty(known, np.int64), np.empty(known, np.int64), np.empty(known, np.int64)
    ways = np.empty(known, np.int8)
    first, n, stretch_end = 0, 0, 0
    while first < known:
        if first >= stretch_end:
            stretch_end = min(_stretch(tick, way, first, state[0]), known)
        end = min(stretch_end, first + MOST_COUNT)
        open_end = more_come and end == known and end - first < MOST_COUNT
        held, i, a = _row(low, high, tick, first, end, state[1], open_end, state[2])
        if held == 0:
            break
        interval[n], count[n], add[n], ways[n] = i, held, a if held > 1 else 0, way[first]
        n += 1
        first += held
        state[0], state[1], state[2] = tick[first - 1], state[1] + held * i + a * (held * (held - 1) // 2), a
    return interval[:n], count[:n], add[:n], ways[:n], first


class Compressor:
    """The rows of one motor, from its steps as they come; how they are cut into calls changes nothing.

    Parameters
    ----------
    slack : ticks that a step may be off, early or late
    spacing : ticks between two pulses, at least
    """

    def __init__(self, slack: int, spacing: int) -> None:
        self._rule = slack, spacing
        self._state = np.zeros(3, dtype=np.int64)
        self._tick: list[IntArray] = []
        self._way: list[WayArray] = []
        self._waiting = 0

    def add(self, tick: IntArray, way: WayArray) -> Rows:
        """Return the rows that are complete with these steps, ticks (n,) rising and ways (n,) ±1."""
        self._tick.append(tick)
        self._way.append(way)
        self._waiting += len(tick)
        return self._rows(final=False) if self._waiting >= BATCH_STEPS else _NO_ROWS

    def finish(self) -> Rows:
        """Return the rows of all steps that are left."""
        return self._rows(final=True) if self._waiting else _NO_ROWS

    def _rows(self, final: bool) -> Rows:
        tick, way = np.concatenate(self._tick), np.concatenate(self._way)
        known = len(tick) if final else len(tick) - 1
        interval, count, add, ways, done = _rows(tick, way, self._state, *self._rule, known)
        self._tick, self._way, self._waiting = [tick[done:]], [way[done:]], len(tick) - done
        return interval, count.astype(np.uint16), add.astype(np.int16), ways


_NO_ROWS: Rows = (np.zeros(0, np.int64), np.zeros(0, np.uint16), np.zeros(0, np.int16), np.zeros(0, np.int8))
