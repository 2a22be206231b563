"""Marlin's queue of blocks: what each target becomes, how far the look-ahead sees, and the trapezoid of each block.

The rules are those of Marlin 2.1.2 (`planner.cpp`, GPL: described, not copied), as far as the real planner's own
blocks show them; the tests compare with these block by block. Speeds mm/s along the block, rates steps/s of its
fastest motor ("events"), s and mm.

    populate    length, nominal speed, acceleration, the speed allowed at its beginning
    look-ahead  backwards what each block can brake from, forwards what it can reach; entry speeds in v²
    trapezoid   whole events of speeding up and braking, no rate below 120 a second

Marlin counts in single precision, and so does this wherever a number is rounded to whole steps next: 279.00001 steps/s
become 280.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel

Singles = NDArray[np.float32]

QUEUE = 16  # blocks in Marlin's buffer (BLOCK_BUFFER_SIZE)
IN_SIGHT = QUEUE - 2  # that wait while the next one is planned: one place is always free, and one block is executed
LOWEST_RATE = 120.0  # steps/s (MINIMAL_STEP_RATE): the timer goes no slower
LOWEST_V2 = 0.05**2  # (mm/s)², MINIMUM_PLANNER_SPEED: how a stop is planned
STRAIGHT, REVERSED = -0.999999, 0.999999  # cosines beyond which two lines are one, or there and back
SHORT_MM, SHORT_COSINE = 1.0, -np.sqrt(0.5)  # where a junction deviation also looks at the arc that lines may be of
LEAST_TURN = 0.033  # rad, below which Marlin's arc cosine does not go

# columns of a row of settings
STEPS, SPEED, ACCELERATION, JERK = (slice(first, first + 4) for first in (0, 4, 8, 12))  # of X Y Z E
PRINT, RETRACT, TRAVEL, DEVIATION, LEAST, LEAST_TRAVEL, SHORTEST_US, SCALE, POLICY, COLUMNS = range(16, 26)
_SPEED, _ACCELERATION, _JERK = SPEED.start, ACCELERATION.start, JERK.start

# columns of a block while it is planned
_START, _END, _MM, _EVENTS, _RATE, _FIRST, _LAST, _ACCEL, _UP, _DOWN, _V, _ENTRY2, _MOST2, _A, _GAIN, _SURE = (
    0, 4, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21,
)  # fmt: skip
_WIDTH = 22


class Targets(NamedTuple):
    """n targets as Marlin's motion queue gets them, each with the settings in force."""

    start: FloatArray  # (n, 4) mm of the motors, after G92; NaN: where the last one ended
    end: FloatArray  # (n, 4) mm of the motors, columns X Y Z E (or A B C E)
    length: FloatArray  # (n,) mm that the block shall count as long; NaN: by its motors
    speed: FloatArray  # (n,) mm/s
    radius: FloatArray  # (n,) mm, of the arc with a joint at its start; 0: none
    arc_left: FloatArray  # (n,) mm of the arc that follow and are not queued yet; 0: none
    rests: BoolArray  # (n,) the queue is empty before it
    settings: Singles  # (n, COLUMNS)


@dataclass(frozen=True, slots=True)
class Blocks:
    """m blocks as the planner leaves them."""

    target: IntArray  # (m,) which one the block reaches
    start: FloatArray  # (m, 4) whole steps
    end: FloatArray  # (m, 4) whole steps
    length: FloatArray  # (m,) mm
    events: FloatArray  # (m,) steps of the fastest motor
    nominal: FloatArray  # (m,) events/s
    entry: FloatArray  # (m,) events/s
    exit: FloatArray  # (m,) events/s
    acceleration: FloatArray  # (m,) events/s²
    accelerate: FloatArray  # (m,) events
    decelerate: FloatArray  # (m,) events

    def __len__(self) -> int:
        return len(self.target)


class BlockPhases(NamedTuple):
    """Speeding up, cruising and braking of m blocks: s, events/s."""

    accel_t: FloatArray
    cruise_t: FloatArray
    decel_t: FloatArray
    entry: FloatArray
    level: FloatArray
    last: FloatArray

    @property
    def duration(self) -> FloatArray:
        """How long each block takes, (m,) s, by its trapezoid over whole events."""
        return self.accel_t + self.cruise_t + self.decel_t


def plan_blocks(targets: Targets, minimum_steps: int, slowdown: bool) -> Blocks:
    """Plan targets as Marlin's queue does.

    targets : in order; the first one says where it starts
    minimum_steps : moves with fewer steps of every motor are joined to the next
    slowdown : moves are stretched while the queue fills
    """
    table, target, count = _blocks(targets, minimum_steps, slowdown)
    return Blocks(target[:count], table[:count, :4], table[:count, 4:8], *table[:count, _MM : _DOWN + 1].T)


def phases_of(b: Blocks) -> BlockPhases:
    """Integrate the trapezoids over their whole events."""
    entry = np.minimum(b.entry, b.nominal)
    top = np.minimum(np.sqrt(entry**2 + 2.0 * b.acceleration * b.accelerate), b.nominal)
    ramp = (top**2 - entry**2) / (2.0 * b.acceleration)  # events; at the nominal rate what is left of them
    level = np.where(b.decelerate > b.accelerate, b.nominal, top)
    last = np.sqrt(np.maximum(level**2 - 2.0 * b.acceleration * (b.events - b.decelerate), 0.0))
    cruise_t = (b.accelerate - ramp) / top + (b.decelerate - b.accelerate) / level
    return BlockPhases((top - entry) / b.acceleration, cruise_t, (level - last) / b.acceleration, entry, level, last)


@kernel
def _blocks(targets: Targets, minimum_steps: int, slowdown: bool) -> tuple[FloatArray, IntArray, int]:
    start, end, length, speed, radius, arc_left, rests, settings = targets
    table, target = np.zeros((len(end), _WIDTH)), np.zeros(len(end), np.int64)
    place = np.zeros(4)
    # of this block and the one before it: mm of each motor per mm (of the line), mm/s of each, nominal and safe speed
    axis_v, behind_v, behind = np.zeros(4, np.float32), np.zeros(4, np.float32), np.zeros(2, np.float32)
    unit, behind_unit = np.zeros(4), np.zeros(4)
    tail, planned, head, leaving2 = 0, 0, 0, LOWEST_V2
    for i in range(len(end)):
        s, block = settings[i], table[head]
        if rests[i]:
            tail = planned = head
        events = 0.0
        for k in range(4):
            if not np.isnan(start[i, 0]):
                place[k] = _whole(start[i, k], s[k])
            block[_START + k], block[_END + k] = place[k], _whole(end[i, k], s[k])
            events = max(events, abs(block[_END + k] - place[k]))
        if events < minimum_steps or events == 0.0:
            continue
        if head - tail >= IN_SIGHT:  # the oldest block leaves
            if planned == tail:
                planned += 1
            tail += 1
        slow_us = s[SHORTEST_US] if slowdown and 2 <= head - tail <= QUEUE // 2 - 1 else 0.0
        _populate(block, events, s, length[i], speed[i], minimum_steps, slow_us, head - tail, unit, axis_v)
        joined = head > tail and behind[0] > 1e-6
        if s[DEVIATION] >= 0.0:
            limit2 = 0.0
            if joined:
                limit2 = min(_deviation(unit, behind_unit, block, s, radius[i]), block[_V] ** 2, behind[0] ** 2)
        else:
            limit, behind[1] = _jerk(axis_v, behind_v, np.float32(block[_V]), behind[0], behind[1], s, joined)
            limit2 = np.float64(limit * limit)
        block[_MOST2], block[_ENTRY2] = limit2, LOWEST_V2
        target[head] = i
        behind[0] = block[_V]
        for k in range(4):
            place[k], behind_unit[k], behind_v[k] = block[_END + k], unit[k], axis_v[k]
        head += 1
        leaving2 = LOWEST_V2
        if arc_left[i] > 0.0:
            leaving2 = max(min(block[_A] * radius[i], 2.0 * block[_A] * arc_left[i]), LOWEST_V2)
        planned = _look_ahead(planned, head, leaving2, table)
    for b in range(head):
        v, leave2 = np.float32(table[b, _V]), table[b + 1, _ENTRY2] if b + 1 < head else leaving2
        _trapezoid(table[b], np.sqrt(np.float32(table[b, _ENTRY2])) / v, np.sqrt(np.float32(leave2)) / v)
    return table, target, head


@kernel
def _whole(mm: float, steps_per_mm: np.float32) -> float:
    """Return the whole steps of a place, as single precision has them."""
    steps = np.float64(np.float32(mm) * steps_per_mm)
    return np.floor(steps + 0.5) if steps >= 0.0 else np.ceil(steps - 0.5)


@kernel
def _populate(
    block: FloatArray,
    events: float,
    s: Singles,
    length: float,
    speed: float,
    minimum_steps: int,
    slow_us: float,
    waiting: int,
    unit: FloatArray,
    axis_v: Singles,
) -> None:
    """Fill in a block's length, nominal speed and acceleration, and the directions and speeds of its motors."""
    square, still = np.float32(0.0), True
    for k in range(4):
        d = block[_END + k] - block[_START + k]
        moved = np.float32(d) * (np.float32(1.0) / s[k])
        unit[k] = moved
        if k < 3:
            square += moved * moved
            still &= abs(d) < minimum_steps
    extrudes = block[_END + 3] != block[_START + 3]
    mm = np.float32(abs(unit[3])) if still else np.float32(np.sqrt(square))
    if not still and not np.isnan(length):
        mm = np.float32(length)
    per_s = np.float32(max(speed, s[LEAST] if extrudes else s[LEAST_TRAVEL])) * (np.float32(1.0) / mm)
    if slow_us > 0.0:
        us = np.floor(1e6 / np.float64(per_s) + 0.5)
        if us < slow_us:
            per_s = np.float32(1e6 / (us + np.floor(2.0 * (slow_us - us) / waiting + 0.5)))
    v = mm * per_s
    rate = np.ceil(np.float32(events) * per_s)
    factor, moves = np.float32(1.0), False
    for k in range(4):
        axis_v[k] = np.float32(unit[k]) * per_s
        if abs(axis_v[k]) > s[_SPEED + k]:
            factor = min(factor, s[_SPEED + k] / abs(axis_v[k]))
        moves |= k < 3 and unit[k] != 0.0
        unit[k] /= mm
    if factor < 1.0:
        for k in range(4):
            axis_v[k] *= factor
        rate, v = np.floor(rate * factor), v * factor
    per_mm = events / np.float64(mm)
    a = np.ceil((s[RETRACT] if not moves else s[PRINT] if extrudes else s[TRAVEL]) * per_mm)
    if moves:
        for k in range(4):
            steps = abs(block[_END + k] - block[_START + k])
            most = np.floor(s[_ACCELERATION + k] * s[k])
            if steps > 0.0 and most < a:
                a = min(a, np.floor(most * events / steps))
    a = np.ceil(s[SCALE] * a)
    block[_MM], block[_EVENTS], block[_RATE], block[_ACCEL] = mm, events, rate, a
    block[_V], block[_A] = v, a / per_mm
    block[_GAIN] = 2.0 * block[_A] * block[_MM]
    block[_SURE] = v * v <= LOWEST_V2 + block[_GAIN]
    if s[DEVIATION] >= 0.0 and extrudes:
        norm = np.sqrt(unit[0] ** 2 + unit[1] ** 2 + unit[2] ** 2 + unit[3] ** 2)
        for k in range(4):
            unit[k] /= norm


@kernel
def _deviation(unit: FloatArray, behind: FloatArray, block: FloatArray, s: Singles, radius: float) -> float:
    """Return the highest v² at the joint of two blocks by junction deviation."""
    cosine, size2 = 0.0, 0.0
    for k in range(4):
        cosine -= unit[k] * behind[k]
        size2 += (unit[k] - behind[k]) ** 2
    if cosine > REVERSED:
        return LOWEST_V2
    a = block[_A]
    for k in range(4):
        along = abs(unit[k] - behind[k]) / np.sqrt(size2) if size2 > 0.0 else 0.0
        if a * along > s[_ACCELERATION + k]:
            a = s[_ACCELERATION + k] / along
    if radius > 0.0:
        return a * radius
    cosine = max(cosine, STRAIGHT)
    half = float(np.sqrt(0.5 * (1.0 - cosine)))
    v2 = a * float(s[DEVIATION]) * half / (1.0 - half)
    if block[_MM] < SHORT_MM and cosine < SHORT_COSINE:
        v2 = min(v2, block[_MM] * a / max(np.arccos(-cosine), LEAST_TURN))
    return v2


@kernel
def _jerk(
    axis_v: Singles,
    behind: Singles,
    v: np.float32,
    behind_nominal: np.float32,
    behind_safe: np.float32,
    s: Singles,
    joined: bool,
) -> tuple[np.float32, np.float32]:
    """Return the highest speed at the joint by classic jerk, and the speed of an instant stop or start."""
    safe, limited, one = v, False, np.float32(1.0)
    for k in range(4):
        jump, most = abs(axis_v[k]), s[_JERK + k]
        if jump > most:
            if limited:
                if jump * safe > most * v:
                    safe = most * v / jump
            else:
                safe, limited = safe * most / jump, True
    if not joined:
        return safe, safe
    smaller = v / behind_nominal if v < behind_nominal else one
    junction = min(v, behind_nominal)
    share, limited = one, False
    for k in range(4):
        leave, enter = behind[k] * smaller * share, axis_v[k] * share
        if leave > enter:
            jump = leave - enter if enter > 0.0 or leave < 0.0 else max(leave, -enter)
        else:
            jump = enter - leave if enter < 0.0 or leave > 0.0 else max(-leave, enter)
        if jump > s[_JERK + k]:
            share, limited = share * s[_JERK + k] / jump, True
    if limited:
        junction *= share
    if behind_safe > np.float32(0.99) * junction and safe > np.float32(0.99) * junction:
        junction = safe
    return junction, safe


@kernel
def _look_ahead(planned: int, head: int, leaving2: float, table: FloatArray) -> int:
    """Backwards: what each block can brake from; forwards: what it can reach. Return the first that may change."""
    changed = False
    for b in range(head - 1, planned, -1):
        block = table[b]
        was = block[_ENTRY2]
        if changed or was != block[_MOST2]:
            after2 = leaving2 if b + 1 == head else table[b + 1, _ENTRY2]
            most2 = block[_MOST2]
            block[_ENTRY2] = most2 if block[_SURE] > 0.0 else min(most2, after2 + block[_GAIN])
        changed = b + 1 == head or block[_ENTRY2] != was
    for b in range(planned + 1, head):
        block, before = table[b], table[b - 1]
        if before[_SURE] == 0.0 and before[_ENTRY2] < block[_ENTRY2]:
            reached2 = before[_ENTRY2] + before[_GAIN]
            if reached2 < block[_ENTRY2]:
                block[_ENTRY2] = reached2
                planned = b
        if block[_ENTRY2] == block[_MOST2]:
            planned = b
    return planned


@kernel
def _trapezoid(block: FloatArray, entry: np.float32, leave: np.float32) -> None:
    """Whole events of speeding up and braking between two shares of the nominal rate."""
    events, nominal, one = np.float32(block[_EVENTS]), np.float32(block[_RATE]), np.float32(1.0)
    lowest, half = np.minimum(np.float32(LOWEST_RATE), nominal), np.float32(0.5)
    first = np.maximum(np.ceil(nominal * np.minimum(entry, one)), lowest)
    last = np.maximum(np.ceil(nominal * np.minimum(leave, one)), lowest)
    per_rate2 = half * (one / np.float32(block[_ACCEL]))
    up, down = per_rate2 * (nominal * nominal - first * first), per_rate2 * (nominal * nominal - last * last)
    rising, falling = np.maximum(np.ceil(up), np.float32(0.0)), np.maximum(np.trunc(down), np.float32(0.0))
    if events - rising - falling < 0.0:
        rising = np.minimum(np.maximum(np.ceil(half * (events + up - down)), np.float32(0.0)), events)
        falling = events - rising
    block[_FIRST], block[_LAST], block[_UP], block[_DOWN] = first, last, rising, events - falling
